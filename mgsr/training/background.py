"""Gaussians of what lies around a found object, so that its renders can be shown in the whole photograph."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy import ndimage

from mgsr.config import Config, make_config
from mgsr.data.backdrop import Color
from mgsr.data.scene import Scene, View
from mgsr.gaussians.gaussians import GaussianModel
from mgsr.start.points import StartingPoints
from mgsr.training.control import TrainingControl
from mgsr.training.run import Training


def train_background(
    scene: Scene,
    masks: Sequence[np.ndarray],
    start: StartingPoints,
    config: Config,
    should_stop: Callable[[], bool] = lambda: False,
    progress: Callable[[float], None] = lambda done: None,
) -> tuple[GaussianModel, Color]:
    """Train a 3D branch on what the photographs show outside the object's masks.

    Returns the Gaussians, in the scene's frame, and the colour behind them, sRGB 0..1.

    scene: the whole scene, without masks. masks [H,W] uint8: the object's in the training views. start: points of the
    whole scene; those on the object are left out. config: of the run; this training is as long as the 2D branch's
    warm-up. progress: receives the share of the work that is done, 0..1.

    Raises Cancelled once should_stop returns True, and TrainingError if training fails.
    """
    options = config.expert.training.background
    views = [_without_object(view, mask, options.mask_margin) for view, mask in zip(scene.train, masks, strict=True)]
    outside = ~_on_object(start.positions, scene.train, masks, options.inside)
    start = StartingPoints(start.positions[outside], start.colors[outside], start.source)
    stages = [f"warmup.gaussian_iterations={config.train.warmup.surfel_iterations}", "mutual.iterations=0"]
    plain = ["branches=gaussians", "reflection=off", "flash=off", "stop_rule=none"]
    settings = make_config(config.preset, seed=config.seed, overrides=[*plain, *stages])
    control = TrainingControl(lambda report: progress(report.done), should_stop)
    around = replace(scene, train=views, test=[])
    model = Training(around, start, settings, control).run().model.gaussians
    assert model is not None
    return model, around.backdrop(settings.train.background).color


def _without_object(view: View, mask: np.ndarray, margin: float) -> View:
    """Return the view with the pixels of a mask [H,W] uint8, and those beside it, marked as invalid.

    margin: width of the margin, as a share of the photograph's longer side.
    """
    import cv2  # imported here, because training needs no OpenCV

    reach = max(1, round(margin * max(mask.shape)))
    around = cv2.dilate(mask, np.ones((2 * reach + 1,) * 2, np.uint8)) > 0
    return replace(view, valid_mask=~around if view.valid_mask is None else view.valid_mask & ~around)


def _on_object(points: np.ndarray, views: Sequence[View], masks: Sequence[np.ndarray], share: float) -> np.ndarray:
    """Return which of the points [P,3] lie inside the masks in more than a share of the views that show them, [P]."""
    shown, inside = np.zeros(len(points)), np.zeros(len(points))
    for view, mask in zip(views, masks, strict=True):
        pixels, depth = view.camera.project(points)
        x, y = pixels.T
        seen = (depth > 0) & (x > 0) & (x < view.camera.width) & (y > 0) & (y < view.camera.height)
        value = ndimage.map_coordinates(mask, [y[seen] - 0.5, x[seen] - 0.5], order=0, mode="nearest")
        shown[seen] += 1
        inside[seen] += value > 127
    return np.asarray((shown > 0) & (inside > share * shown))
