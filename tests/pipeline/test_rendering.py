"""Renders that replace the photographs."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from mgsr.config import Config
from mgsr.gaussians.gaussians import GaussianModel
from mgsr.gaussians.trained_model import TrainedModel
from mgsr.pipeline.rendering import rendered_scene
from tests.training.ball import before


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
