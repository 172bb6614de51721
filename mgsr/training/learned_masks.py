"""Masks for photographs before a plain backdrop, learned by small 3D branches.

The backdrop's colour lies behind the splats, so the splats need to cover only the object. A colour key would make
holes where the object has the backdrop's colour. Splats make none, because they must explain all photographs at once.

A first branch starts at random points of the ball. Splats outside the object take the backdrop's colour, which looks
the same as transparency. A loss on opacity removes these splats, but its contours are rough. A second branch starts on
the visual hull of these contours. There, no splat is superfluous, so it has no loss on opacity.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import torch

from mgsr.config import ExpertConfig
from mgsr.data.images import to_uint8
from mgsr.data.masks import leave_borders_free, with_masks
from mgsr.data.scene import Scene, View
from mgsr.errors import SceneError
from mgsr.gaussians.gaussians import GaussianModel
from mgsr.parallel import one_torch_thread
from mgsr.renderers.gaussians import render_gaussians
from mgsr.start.points import StartingPoints
from mgsr.start.starting_points import ball_points, hull_points
from mgsr.training.proxy_model import ProxyTraining, small_view, train_proxy_model


def learn_masks(
    scene: Scene,
    seed: int,
    should_stop: Callable[[], bool] = lambda: False,
    progress: Callable[[float], None] = lambda done: None,
    expert: ExpertConfig = ExpertConfig(),
) -> list[np.ndarray] | None:
    """Learn masks [H,W] uint8 of the training views of a scene that has a plain backdrop and no masks.

    Returns None if the splats outline no object. Then their masks have no common hull, or cover the images' borders.
    The same seed gives the same masks, on any number of cores. progress: called with the completed share, 0..1.
    expert: the options of all algorithms.

    Raises Cancelled once should_stop returns True, and TrainingError if training fails.
    """

    def learned(
        start: StartingPoints, views: list[View], iterations: int, cost: float, report: Callable[[float], None]
    ) -> GaussianModel:
        training = ProxyTraining("learned_masks", options.degree, iterations, seed, proxy, cost)
        return train_proxy_model(scene, start, views, training, should_stop, report)

    options, proxy = expert.training.learned_masks, expert.training.learned_masks.proxy
    share = options.rough_iterations / (options.rough_iterations + options.iterations)
    with one_torch_thread():
        views = [small_view(view, options.rough_side) for view in scene.train]
        start = ball_points(views, proxy.points, seed, expert.start.colors)
        rough = learned(
            start, views, options.rough_iterations, options.opacity_cost, lambda done: progress(share * done)
        )
        try:
            masks = _opacities(rough, views, options.rough_side)
            masked = with_masks(replace(scene, train=views), masks)
            start = hull_points(masked, proxy.points, seed, options.voxels, expert.start)
        except SceneError:
            return None
        views = [small_view(view, proxy.side) for view in scene.train]
        fine = learned(start, views, options.iterations, 0.0, lambda done: progress(share + (1 - share) * done))
        masks = _opacities(fine, scene.train, proxy.side)
    return masks if leave_borders_free(masks, scene.options.mask_use) else None


@torch.no_grad()
def _opacities(model: GaussianModel, views: Sequence[View], side: int) -> list[np.ndarray]:
    """Render the opacity of the model in the views, as masks [H,W] uint8.

    The model was trained on photographs of `side` pixels, so its edges are as soft as those pixels. This function
    sharpens them to the views' pixels.
    """
    masks = []
    for view in views:
        steeper = max(1.0, max(view.camera.width, view.camera.height) / side)
        alpha = render_gaussians(model, view.camera, depth=False).alpha.numpy()
        masks.append(to_uint8(255 * (0.5 + steeper * (alpha - 0.5))))
    return masks
