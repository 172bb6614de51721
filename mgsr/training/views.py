"""Photographs made ready for training, and the order in which they come."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from mgsr.config import Background
from mgsr.data.camera import Camera
from mgsr.data.scene import View
from mgsr.losses.target import Target

Color = tuple[float, float, float]
CPU = torch.device("cpu")


@dataclass(frozen=True)
class TrainingView:
    """One photograph as tensors, made once.

    color [H,W,3] float32 0..1, times alpha where there is one; alpha [H,W] float32 0..1 or None; region: where the
    photographic losses look (see Target); covered [P] int64: the pixels that the mask touches, row x W + column, None
    without masks.
    """

    name: str
    camera: Camera
    color: Tensor
    alpha: Tensor | None
    region: tuple[int, int, int, int] | None = None
    off_edge: Tensor | None = None
    covered: Tensor | None = None

    @cached_property
    def transparency(self) -> Tensor | None:
        """1 - alpha, [H,W]."""
        return None if self.alpha is None else 1 - self.alpha

    def target(self, background: Color) -> Target:
        """The photograph on a background, for the losses."""
        if self.transparency is None:
            return Target(self.color, None, self.camera)
        composite = torch.empty_like(self.color)
        for channel, value in enumerate(background):  # a quarter of the time of a broadcast over three channels
            torch.add(self.color[..., channel], self.transparency, alpha=value, out=composite[..., channel])
        return Target(composite, self.alpha, self.camera, self.region, self.off_edge)


def prepare_views(
    views: list[View],
    masked: bool,
    margin: int | None = None,
    edge_band: int = 0,
    device: torch.device = CPU,
    reduce: int = 1,
) -> list[TrainingView]:
    """The views as tensors on a device; with `masked`, premultiplied by their alpha, otherwise alpha is ignored.

    edge_band: half width in pixels of the strip around the masks' outlines that `off_edge` marks.
    margin: with masks, the photographic losses look only at the mask's bounding box and this many pixels around it.
    reduce: how many pixels, along each side, are averaged into one; edge_band and margin are of these.
    """
    return [_prepared(view, masked, margin, edge_band, device, reduce) for view in views]


def _prepared(
    view: View, masked: bool, margin: int | None, edge_band: int, device: torch.device, reduce: int
) -> TrainingView:
    color = torch.from_numpy(view.image).to(torch.float32) / 255
    if not masked or view.alpha is None:
        camera, color = _reduced(view.camera, color, reduce)
        return TrainingView(view.name, camera, color.to(device), None)
    alpha = torch.from_numpy(view.alpha).to(torch.float32) / 255
    camera, both = _reduced(view.camera, torch.cat([color * alpha[..., None], alpha[..., None]], dim=-1), reduce)
    color, alpha = both[..., :3].contiguous(), both[..., 3].contiguous()
    # Found on the host, so that a card is never waited for.
    drawn = alpha.numpy()
    region = None if margin is None else bounding_region(drawn, margin)
    off_edge = outline_weights(alpha, edge_band).to(device) if edge_band else None
    covered = torch.from_numpy(np.flatnonzero(drawn)).to(device)
    return TrainingView(view.name, camera, color.to(device), alpha.to(device), region, off_edge, covered)


def _reduced(camera: Camera, image: Tensor, by: int) -> tuple[Camera, Tensor]:
    """The camera and the mean [H',W',C] of each by x by pixels of an image [H,W,C]; sides are rounded up."""
    if by == 1:
        return camera, image
    height, width = -(-camera.height // by), -(-camera.width // by)
    small = torch.nn.functional.adaptive_avg_pool2d(image.permute(2, 0, 1)[None], (height, width))
    return camera.resized(width, height), small[0].permute(1, 2, 0).contiguous()


def outline_weights(alpha: Tensor, band: int) -> Tensor:
    """[H,W]: 0 where alpha's outline (its value 1/2) passes within `band` pixels, diagonals included, 1 elsewhere."""
    inside = (alpha > 0.5).to(alpha.dtype)[None]
    size = 2 * band + 1
    widest = torch.nn.functional.max_pool2d(inside, size, 1, band)
    narrowest = -torch.nn.functional.max_pool2d(-inside, size, 1, band)
    return (widest == narrowest)[0].to(alpha.dtype)


def bounding_region(alpha: np.ndarray, margin: int) -> tuple[int, int, int, int] | None:
    """(y0, y1, x0, x1), ends excluded, of what an alpha image [H,W] covers and `margin` pixels around it; None where it
    covers nothing."""
    rows, columns = np.flatnonzero(alpha.any(axis=1)), np.flatnonzero(alpha.any(axis=0))
    if not len(rows):
        return None
    (y0, y1), (x0, x1) = (rows[0] - margin, rows[-1] + 1 + margin), (columns[0] - margin, columns[-1] + 1 + margin)
    height, width = alpha.shape
    return max(0, int(y0)), min(height, int(y1)), max(0, int(x0)), min(width, int(x1))


def pick_background(kind: Background, masked: bool, generator: torch.Generator) -> Color:
    """The colour behind the splats in one iteration; draws from the generator only where it is random."""
    if kind is Background.BLACK:
        return (0.0, 0.0, 0.0)
    if kind is Background.RANDOM or (kind is Background.AUTO and masked):
        red, green, blue = torch.rand(3, generator=generator).tolist()
        return (red, green, blue)
    return (1.0, 1.0, 1.0)


def plain_background(kind: Background) -> Color:
    """The colour on which renderings are judged: white, unless training knows black alone."""
    return (0.0, 0.0, 0.0) if kind is Background.BLACK else (1.0, 1.0, 1.0)


def color_tensor(color: Color, device: torch.device) -> Tensor:
    """[3] on a device; the host does not wait for the copy."""
    return torch.tensor(color).to(device, non_blocking=True)


class ViewCycle:
    """Indices of views, each once an epoch, in an order that the generator shuffles anew for each."""

    def __init__(self, count: int, generator: torch.Generator) -> None:
        self.count = count
        self.generator = generator
        self.order: list[int] = []

    def next(self) -> int:
        """The next view's index."""
        if not self.order:
            self.order = torch.randperm(self.count, generator=self.generator).tolist()
        return self.order.pop()

    @property
    def at_epoch_end(self) -> bool:
        """Whether every view has had its turn in this epoch."""
        return not self.order
