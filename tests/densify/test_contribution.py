"""Tests of each splat's contribution to images, and of which splats can go."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch

from mgsr.data.camera import Camera
from mgsr.densify.contribution import contributions, largest_contributions, least_contributing
from mgsr.gaussians.gaussians import GaussianModel
from mgsr.gaussians.surfels import SurfelModel
from tests.ops.splat_scenes import splat_arguments
from tests.oracles import gaussians, surfels
from tests.training.ball import ball_scene

COUNT = 12


def some_surfels() -> SurfelModel:
    """Build surfels that hide each other, in front of all cameras of the ball."""
    draw = noise()
    return SurfelModel(0.4 * draw(3), draw(4), 0.3 * draw(2) - 2.0, 2 * draw(), draw(1, 3))


def some_gaussians(split: bool) -> GaussianModel:
    """Build Gaussians that hide each other, in front of all cameras of the ball."""
    draw = noise()
    half = (draw(), draw(), draw(1, 3)) if split else ()
    return GaussianModel(0.4 * draw(3), draw(4), 0.3 * draw(3) - 2.0, 2 * draw(), draw(1, 3), *half, low_pass=0.1)


def noise() -> Callable[..., torch.Tensor]:
    """Return a function that draws [COUNT,...], always the same in the same order."""
    generator = torch.Generator().manual_seed(3)
    return lambda *shape: torch.randn(COUNT, *shape, generator=generator)


@pytest.mark.parametrize("kind", ["surfels", "gaussians", "split gaussians"])
def test_it_is_what_a_lone_white_splat_adds_to_black_ones(kind: str) -> None:
    model = some_surfels() if kind == "surfels" else some_gaussians(split=kind.startswith("split"))
    cameras = [view.camera for view in ball_scene(size=24, train=3).train]
    alone = torch.tensor([[added(model, camera, i) for i in range(COUNT)] for camera in cameras])
    assert alone.sum(0).min() < 0.05 * alone.sum(0).max()
    torch.testing.assert_close(contributions(model, cameras), alone.sum(0), rtol=1e-4, atol=1e-3)
    torch.testing.assert_close(largest_contributions(model, cameras), alone.amax(0), rtol=1e-4, atol=1e-3)


def added(model: SurfelModel | GaussianModel, camera: Camera, index: int) -> float:
    return (
        added_by_surfel(model, camera, index)
        if isinstance(model, SurfelModel)
        else added_by_gaussian(model, camera, index)
    )


def added_by_surfel(model: SurfelModel, camera: Camera, index: int) -> float:
    """Return the light in the oracle's image where one surfel is white and all others are black."""
    tensors = (model.means, model.quats, model.scales(), model.opacities(), white(index))
    geometry = splat_arguments(t.double() for t in tensors)
    view = torch.as_tensor(camera.K), torch.as_tensor(camera.cam_from_world), camera.width, camera.height
    return float(surfels.render(*geometry, *view, torch.zeros(3)).color[..., 0].sum())


def added_by_gaussian(model: GaussianModel, camera: Camera, index: int) -> float:
    """Return the light in the oracle's image where one Gaussian, in both halves, is white and all others are black."""
    tensors = (model.means, model.quats, model.scales(), model.opacities(), white(index))
    geometry = splat_arguments(t.double() for t in tensors)
    reflected = None
    if model.split:
        reflected = (model.refl_opacities().double(), geometry[-1], model.weights().double())
    images = gaussians.render(*geometry, camera, torch.zeros(3), reflected, model.low_pass)
    if images.reflected is None or images.weight is None:
        return float(images.color[..., 0].sum())
    return float((images.color[..., 0] + images.weight * images.reflected[..., 0]).sum())


def white(index: int) -> torch.Tensor:
    """Return colours of which one is white and all others are black."""
    return torch.eye(COUNT)[:, index, None].expand(-1, 3)


def test_the_least_that_together_stay_below_the_share() -> None:
    weights = torch.tensor([5.0, 0.0, 1.0, 3.0, 1.0])
    assert least_contributing(weights, 0.15).tolist() == [False, True, True, False, False]
    assert least_contributing(weights, 0.2).tolist() == [False, True, True, False, False]
    assert least_contributing(weights, 0.21).tolist() == [False, True, True, False, True]
    assert not least_contributing(weights + 1, 0.0).any()
    assert not least_contributing(torch.zeros(4), 0.5).any()
