"""The 3D branch as its model says that it must be drawn."""

from __future__ import annotations

import pytest
import torch

from mgsr.gaussians.gaussians import GaussianModel
from mgsr.renderers.gaussians import render_gaussians
from tests.ops.splat_scenes import camera, splat_arguments
from tests.oracles import gaussians as oracle


@pytest.mark.parametrize("low_pass", [0.1, 0.3])
def test_splats_are_drawn_with_their_own_low_pass(low_pass: float) -> None:
    """Check that splats are drawn with their own low-pass; under a pixel wide, it makes most of what is seen."""
    generator = torch.Generator().manual_seed(0)

    def draw(*shape: int) -> torch.Tensor:
        return torch.randn(30, *shape, generator=generator)

    model = GaussianModel(
        0.3 * draw(3), draw(4), 0.2 * draw(3) - 5.5, 2 + draw(), draw(1, 3), low_pass=low_pass
    ).detached()
    view = camera()
    center = torch.tensor(view.center, dtype=torch.float32)
    tensors = (model.means, model.quats, model.scales(), model.opacities(), model.colors(center))
    splats = splat_arguments(tensor.double() for tensor in tensors)
    expected = oracle.render(*splats, view, torch.zeros(3).double(), low_pass=low_pass)
    assert expected.alpha.max() > 0.3
    assert (render_gaussians(model, view).alpha - expected.alpha).abs().max() < 1e-5
