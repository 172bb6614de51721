"""Each splat's contribution to images, by which superfluous splats are pruned."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import torch
from torch import Tensor

from mgsr.data.camera import Camera
from mgsr.gaussians.gaussians import GaussianModel
from mgsr.gaussians.surfels import SurfelModel
from mgsr.ops.gaussians import GaussianOptions, Reflected, rasterize_gaussians
from mgsr.ops.surfels import rasterize_surfels


def contributions(model: SurfelModel | GaussianModel, cameras: Sequence[Camera]) -> Tensor:
    """Return each splat's contribution [N]: its blending weights summed over all pixels of all cameras.

    A weight is the splat's alpha times the transmittance before it; a reflected half's is also multiplied by the
    pixel's reflection weight.
    """
    total = torch.zeros_like(model.opacity_logits)
    for each in _contributions(model, cameras):
        total += each
    return total


def largest_contributions(model: SurfelModel | GaussianModel, cameras: Sequence[Camera]) -> Tensor:
    """Return each splat's largest contribution [N] to a camera's image (see `contributions`).

    Unlike the sum, it is as large where few photographs show the surface as where many do.
    """
    largest = torch.zeros_like(model.opacity_logits)
    for each in _contributions(model, cameras):
        largest = torch.maximum(largest, each)
    return largest


def _contributions(model: SurfelModel | GaussianModel, cameras: Sequence[Camera]) -> Iterator[Tensor]:
    """Yield each splat's contribution [N] to each camera's image.

    An image is linear in the splats' colours, so its derivatives with respect to them are the blending weights.
    """
    model = model.detached()
    for camera in cameras:
        white = torch.ones_like(model.means, requires_grad=True)
        (weights,) = torch.autograd.grad(_drawn(model, white, camera).sum(), white)
        yield weights[:, 0]


def least_contributing(contributions: Tensor, share: float) -> Tensor:
    """Return which splats [N] bool, taken least first, together contribute less than `share` of the sum.

    contributions [N]: of the splats. No splat is chosen where none contributes anything.
    """
    least_first = contributions.argsort(stable=True)
    within = contributions[least_first].cumsum(0, dtype=torch.float64) < share * contributions.sum(dtype=torch.float64)
    return torch.empty_like(within).scatter_(0, least_first, within)


def _drawn(model: SurfelModel | GaussianModel, colors: Tensor, camera: Camera) -> Tensor:
    """Render one channel [H,W] of an image of these colours [N,3], in both halves where there are two, on black."""
    geometry = (model.means, model.quats, model.scales(), model.opacities())
    black = colors.new_zeros(3)
    if isinstance(model, SurfelModel):
        return rasterize_surfels(*geometry, colors, camera, black).color[..., 0]
    reflected = Reflected(model.refl_opacities(), colors, model.weights()) if model.split else None
    options = GaussianOptions(low_pass=model.low_pass, depth=False)
    raster = rasterize_gaussians(*geometry, colors, camera, black, reflected, options)
    if raster.reflected is None or raster.weight is None:
        return raster.color[..., 0]
    return raster.color[..., 0] + raster.weight.detach() * raster.reflected[..., 0]
