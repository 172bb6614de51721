"""Renders that replace the photographs, and opacity that replaces masks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy import ndimage

from mgsr.config import Config, make_config
from mgsr.data.scene import Scene
from mgsr.gaussians.gaussians import GaussianModel
from mgsr.gaussians.trained_model import TrainedModel
from mgsr.pipeline.rendering import masked_scene, rendered_scene
from mgsr.training.run import Training
from tests.training.ball import ball_points, ball_scene, before


@pytest.mark.parametrize("color", [(0, 0, 0), (90, 120, 60)])
def test_without_masks_renders_lie_on_the_backdrop(color: tuple[int, int, int]) -> None:
    """Check that a render of one grey, nearly opaque Gaussian lies on the backdrop."""
    scene = before(color, noise=0)
    grey = GaussianModel(
        means=torch.zeros(1, 3),
        quats=torch.tensor([[1.0, 0, 0, 0]]),
        log_scales=torch.full((1, 3), -2.0),
        opacity_logits=torch.full((1,), 8.0),
        sh=torch.zeros(1, 1, 3),
        low_pass=0.05,
    )
    rendered = rendered_scene(TrainedModel(None, grey), scene, Config())
    for view in rendered.train:
        assert view.alpha is None
        np.testing.assert_array_equal(view.image[0, 0], color)
        middle = view.image[view.camera.height // 2, view.camera.width // 2]
        assert np.abs(middle.astype(int) - 128).max() <= 2


def test_opacity_is_nearer_to_the_truth_than_inexact_masks() -> None:
    """Check that what training makes of masks that are too large or too small errs less than these."""
    true = ball_scene(size=64, train=16)
    grown = [ndimage.grey_dilation if number % 2 else ndimage.grey_erosion for number in range(len(true.train))]
    wrong = [replace(view, alpha=grow(view.alpha, (5, 5))) for view, grow in zip(true.train, grown, strict=True)]
    scene = replace(true, train=wrong, mask_error=2.0)
    short = ["warmup.surfel_iterations=100", "warmup.gaussian_iterations=300", "mutual.iterations=100"]
    config = make_config("draft", overrides=["reflection=off", *short])
    model = Training(scene, ball_points(), config).run().model
    given, learned = error(scene, true), error(masked_scene(model, scene, config), true)
    assert learned < given / 2
    exact = replace(scene, mask_error=0.1)
    assert masked_scene(model, exact, config) is exact
    surfels = TrainedModel(model.surfels, None)
    assert masked_scene(surfels, scene, config) is scene


def error(scene: Scene, true: Scene) -> float:
    """Return the mean difference between the masks of two scenes, 0..255."""
    apart = []
    for one, other in zip(scene.train, true.train, strict=True):
        assert one.alpha is not None and other.alpha is not None
        apart.append(np.abs(one.alpha.astype(float) - other.alpha).mean())
    return float(np.mean(apart))
