"""Error-driven growth of the 3D branch: Gaussians are added where renderings differ visibly from the photographs, and
those that carry least make room for as many more.

A new Gaussian has a pixel's size and the photograph's colour, and lies on the pixel's ray at the rendered depth, as in
ConeGS (Baranowski et al. 2025). The number of differing pixels, not a fixed count, says how many are added.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from mgsr.config import DensifyConfig
from mgsr.data.camera import Camera
from mgsr.densify.carried import carried
from mgsr.gaussians.volumes import VolumeModel

SOLID = 0.3  # alpha from which a rendered depth is taken for a surface's
WINDOW = 3  # pixels along a side over which differences are averaged, so that sensor noise hardly counts


@dataclass(frozen=True)
class RenderedView:
    """A training view beside its rendering.

    wanted and color [H,W,3]: the photograph and the rendering, sRGB, on one background; base [H,W,3]: the part of
    `color` that the Gaussians' own colours give (without reflected light, and as under even light); depth [H,W]: camera
    z; alpha [H,W]; known [H,W] bool: the pixels that the photograph shows, None where it shows all.
    """

    camera: Camera
    wanted: Tensor
    color: Tensor
    base: Tensor
    depth: Tensor
    alpha: Tensor
    known: Tensor | None = None


@dataclass(frozen=True)
class NewPoints:
    """Where Gaussians are added: positions [M,3] in the scene's frame, sizes [M]: a pixel's side there, in the scene's
    unit; colors [M,3], sRGB 0..1."""

    positions: Tensor
    sizes: Tensor
    colors: Tensor


def visible_error(view: RenderedView, tolerance: float) -> Tensor:
    """Return how much each pixel differs, [H,W]: the mean over the channels of the locally averaged difference, and 0
    where it is under the tolerance (sRGB 0..1), where no surface is rendered, and where the photograph is not known."""
    difference = (view.wanted - view.color).permute(2, 0, 1)
    if view.known is not None:
        difference = difference * view.known
    smooth = torch.nn.functional.avg_pool2d(difference[None], WINDOW, 1, WINDOW // 2)[0]
    error = smooth.abs().mean(dim=0)
    counts = (error > tolerance) & (view.alpha > SOLID)
    if view.known is not None:
        counts &= view.known
    return error * counts


def growth(error: Sequence[Tensor], count: int, config: DensifyConfig) -> tuple[int, int]:
    """Return how many of `count` Gaussians are replaced, and how many are added beyond them.

    error: of some views (see `visible_error`). Each number is at most the pixels that differ in a view, on average, and
    at most a share of the count; all together stay under config.max_count.
    """
    pixels = sum(int((each > 0).sum()) for each in error) // max(1, len(error))
    replaced = min(int(config.replace * count), pixels)
    added = min(int(config.growth * count), pixels, max(0, config.max_count - count))
    return replaced, added


def new_points(
    views: Sequence[RenderedView], error: Sequence[Tensor], count: int, generator: torch.Generator
) -> NewPoints:
    """Draw `count` different pixels of the views (fewer where fewer differ), each with a probability in proportion to
    its error, and return where their surface is."""
    weight = torch.cat([each.reshape(-1) for each in error])
    count = min(count, int((weight > 0).sum()))
    # The largest keys log(weight) + Gumbel noise are a draw without replacement (Vieira 2014).
    uniform = torch.rand(weight.shape, generator=generator).to(weight.device).clamp(1e-12, 1 - 1e-7)
    chosen = (weight.log() - (-uniform.log()).log()).topk(count).indices.sort().values
    ends = torch.tensor([each.numel() for each in error], device=weight.device).cumsum(0)
    parts = [
        _lifted(view, chosen[(chosen >= end - each.numel()) & (chosen < end)] - (end - each.numel()))
        for view, each, end in zip(views, error, ends, strict=True)
    ]
    return NewPoints(*(torch.cat(tensors) for tensors in zip(*parts, strict=True)))


def without_least_carrying(model: VolumeModel, views: Sequence[RenderedView], count: int) -> Tensor:
    """Return ascending indices [N - count] int64 of the Gaussians without those that carry least of the views'
    light."""
    light = carried(model, [view.camera for view in views])
    return light.argsort(stable=True)[count:].sort().values


def _lifted(view: RenderedView, pixels: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Positions, sizes and colours of pixels [P], row x W + column."""
    width = view.depth.shape[1]
    intrinsics, pose = (
        torch.from_numpy(matrix).to(view.depth) for matrix in (view.camera.K, view.camera.cam_from_world)
    )
    depth = view.depth.reshape(-1)[pixels]
    x = (pixels % width + 0.5 - intrinsics[0, 2]) / intrinsics[0, 0]
    y = (pixels // width + 0.5 - intrinsics[1, 2]) / intrinsics[1, 1]
    points = torch.stack([x * depth, y * depth, depth], dim=1)
    lacking = (view.wanted - view.color).reshape(-1, 3)[pixels]
    colors = (view.base.reshape(-1, 3)[pixels] + lacking).clamp(0, 1)
    return (points - pose[:3, 3]) @ pose[:3, :3], depth / intrinsics[0, 0], colors
