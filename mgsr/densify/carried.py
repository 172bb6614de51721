"""How much of the pictures each splat carries: those that together carry next to nothing can go."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from mgsr.data.camera import Camera
from mgsr.gaussians.surfels import SurfelModel
from mgsr.gaussians.volumes import VolumeModel
from mgsr.ops.surfels import rasterize_surfels
from mgsr.ops.volumes import Reflected, VolumeOptions, rasterize_volumes


def carried(model: SurfelModel | VolumeModel, cameras: Sequence[Camera]) -> Tensor:
    """The sum over all pixels of all cameras of each splat's blending weight, [N]: opacity times the transmittance
    before it; of a reflected half, times what the pixel adds of that.

    An image is linear in the splats' colours, so its derivatives to them are these weights.
    """
    model = model.detached()
    total = torch.zeros_like(model.opacity_logits)
    for camera in cameras:
        white = torch.ones_like(model.means, requires_grad=True)
        (weights,) = torch.autograd.grad(_drawn(model, white, camera).sum(), white)
        total += weights[:, 0]
    return total


def faintest(carried: Tensor, share: float) -> Tensor:
    """Which splats [N] bool together carry less than `share` of all, the least first; none where none carries any."""
    least_first = carried.argsort(stable=True)
    within = carried[least_first].cumsum(0, dtype=torch.float64) < share * carried.sum(dtype=torch.float64)
    return torch.empty_like(within).scatter_(0, least_first, within)


def _drawn(model: SurfelModel | VolumeModel, colors: Tensor, camera: Camera) -> Tensor:
    """One channel of an image of these colours, in both halves where there are two, on black, [H,W]."""
    geometry = (model.means, model.quats, model.scales(), model.opacities())
    black = colors.new_zeros(3)
    if isinstance(model, SurfelModel):
        return rasterize_surfels(*geometry, colors, camera, black).color[..., 0]
    reflected = Reflected(model.refl_opacities(), colors, model.weights()) if model.split else None
    options = VolumeOptions(low_pass=model.low_pass, depth=False)
    raster = rasterize_volumes(*geometry, colors, camera, black, reflected, options)
    if raster.reflected is None or raster.weight is None:
        return raster.color[..., 0]
    return raster.color[..., 0] + raster.weight.detach() * raster.reflected[..., 0]
