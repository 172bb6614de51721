"""Error-driven growth of the 3D branch: Gaussians are added where renderings differ visibly from the photographs.

Some of the new Gaussians replace those of least contribution, and others are added. A new Gaussian has a pixel's size
and the photograph's colour, and lies on the pixel's ray at the rendered depth, as in ConeGS (Baranowski et al. 2025).
Their number is not fixed. It follows from the number of differing pixels that other views confirm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from mgsr.config import GaussianDensifyConfig
from mgsr.config.expert import ErrorGrowthOptions
from mgsr.data.camera import Camera
from mgsr.densify.contribution import contributions
from mgsr.gaussians.gaussians import GaussianModel


@dataclass(frozen=True)
class ViewResidual:
    """The residual of a training view's rendering.

    residual [H,W,3]: the photograph minus the rendering, sRGB, on the same background.
    base [H,W,3]: the rendering of the Gaussians' own colours, without reflected light and under even light.
    depth [H,W]: camera z.
    alpha [H,W]: the rendered alpha.

    At invalid pixels of the photograph, residual and alpha are 0.
    """

    camera: Camera
    residual: Tensor
    base: Tensor
    depth: Tensor
    alpha: Tensor


@dataclass(frozen=True)
class NewPoints:
    """The points at which Gaussians are added.

    positions [M,3]: in the scene's frame.
    sizes [M]: the side of a pixel at the point, in the scene's unit.
    colors [M,3]: sRGB 0..1.
    residual [M,3]: the photograph minus the rendering at the point.
    """

    positions: Tensor
    sizes: Tensor
    colors: Tensor
    residual: Tensor

    def rows(self, chosen: Tensor) -> NewPoints:
        """Return a subset of the points, by a mask [N] bool or indices [M] int64."""
        return NewPoints(self.positions[chosen], self.sizes[chosen], self.colors[chosen], self.residual[chosen])


def visible_error(view: ViewResidual, tolerance: float, options: ErrorGrowthOptions = ErrorGrowthOptions()) -> Tensor:
    """Return each pixel's visible error [H,W]: the locally averaged residual, in the mean over the channels.

    It is 0 where it is under the tolerance (sRGB 0..1) or no surface is rendered.
    """
    planes, window = view.residual.permute(2, 0, 1)[None], options.window
    smooth = torch.nn.functional.avg_pool2d(planes, window, 1, window // 2, count_include_pad=False)[0]
    error = smooth.abs().mean(dim=0)
    return error * ((error > tolerance) & (view.alpha > options.solid))


def planned_changes(error: Sequence[Tensor], count: int, config: GaussianDensifyConfig) -> tuple[int, int]:
    """Return how many of `count` Gaussians to replace, and how many to add beyond them.

    error: of some views, [H,W] each (`visible_error`). Each number is at most the mean number of differing pixels in a
    view, and at most a share of the count; all together stay under config.max_count.
    """
    pixels = sum(int((each > 0).sum()) for each in error) // max(1, len(error))
    replaced = min(int(config.replace * count), pixels)
    added = min(int(config.growth * count), pixels, max(0, config.max_count - count))
    return replaced, added


def new_points(
    views: Sequence[ViewResidual], error: Sequence[Tensor], count: int, generator: torch.Generator
) -> NewPoints:
    """Draw `count` different pixels of the views by their error, and return the surface points that they show.

    A pixel's probability is in proportion to its error [H,W]. Fewer are drawn where fewer differ.
    """
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


def not_contradicted(
    points: NewPoints, views: Sequence[ViewResidual], hidden: float = ErrorGrowthOptions().hidden
) -> NewPoints:
    """Return the points whose residual agrees among the views that see them.

    Residuals of a highlight differ in sign between views, and those of noise do so half of the time.
    Points that no other view sees are left out, too. hidden: the pixel sizes that a point may lie off the rendered
    surface of a view that sees it.
    """
    agreed = sum((_agreement(points, view, hidden) for view in views), torch.zeros_like(points.sizes))
    # The point's own view is among the views, and agrees with itself.
    return points.rows(agreed > points.residual.square().sum(dim=1))


def _agreement(points: NewPoints, view: ViewResidual, hidden: float) -> Tensor:
    """Return the products [M] of the points' own residuals and this view's there; 0 where it does not see them."""
    intrinsics, pose = _matrices(view)
    height, width = view.depth.shape
    local = points.positions @ pose[:3, :3].T + pose[:3, 3]
    x, y, w = (local @ intrinsics.T).unbind(1)
    column, row = (x / w).floor().long(), (y / w).floor().long()
    inside = (w > 0) & (column >= 0) & (column < width) & (row >= 0) & (row < height)
    pixel = torch.where(inside, row * width + column, 0)
    seen = inside & ((view.depth.reshape(-1)[pixel] - w).abs() < hidden * points.sizes)
    return (points.residual * view.residual.reshape(-1, 3)[pixel]).sum(dim=1) * seen


def without_least_contributing(model: GaussianModel, views: Sequence[ViewResidual], count: int) -> Tensor:
    """Return ascending indices [N - count] int64 of all Gaussians but the `count` that contribute least."""
    light = contributions(model, [view.camera for view in views])
    return light.argsort(stable=True)[count:].sort().values


def _lifted(view: ViewResidual, pixels: Tensor) -> tuple[Tensor, ...]:
    """Return the positions, sizes, colours and residuals of pixels [P], given as row x W + column."""
    width = view.depth.shape[1]
    intrinsics, pose = _matrices(view)
    depth = view.depth.reshape(-1)[pixels]
    x = (pixels % width + 0.5 - intrinsics[0, 2]) / intrinsics[0, 0]
    y = (pixels // width + 0.5 - intrinsics[1, 2]) / intrinsics[1, 1]
    points = torch.stack([x * depth, y * depth, depth], dim=1)
    residual = view.residual.reshape(-1, 3)[pixels]
    colors = (view.base.reshape(-1, 3)[pixels] + residual).clamp(0, 1)
    return (points - pose[:3, 3]) @ pose[:3, :3], depth / intrinsics[0, 0], colors, residual


def _matrices(view: ViewResidual) -> tuple[Tensor, Tensor]:
    """Return the camera's K [3,3] and cam_from_world [4,4] on the images' device."""
    camera = view.camera
    return torch.from_numpy(camera.K).to(view.depth), torch.from_numpy(camera.cam_from_world).to(view.depth)
