"""Photographs prepared for training, and the order in which training uses them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from mgsr.data.backdrop import Backdrop, Color
from mgsr.data.camera import Camera
from mgsr.data.pixels import PixelStore
from mgsr.data.scene import View
from mgsr.data.stacking import averaged
from mgsr.losses.target import Target
from mgsr.ops.pixels import composite

CPU = torch.device("cpu")

# Data derived from the views stays in memory up to this size. Larger data goes to a file, like the decoded photographs.
MADE_BYTES = 1 << 30


@dataclass(frozen=True)
class TrainingView:
    """One photograph as bytes, or the part of it around the object, with the regions that its losses need.

    Each iteration converts it to a target. Bytes share the scene's memory, whereas hundreds of large photographs as
    floats would fill the memory. Flat indices are row x W + column.

    image [H,W,3] uint8: straight colours.
    mask [H,W] uint8: None without masks.
    whole: the whole photograph's width and height, in pixels of this view.
    off_edge [H,W] bool: the pixels away from the mask's contour.
    covered [P] int64: the flat indices (row x W + column) of pixels that the mask touches; None without masks.
    invalid [P] int64: the flat indices of invalid pixels, where the mask is 0 and the image arbitrary; None if all
    pixels are valid.
    irradiance [H,W] uint8, white [3] uint8: as in `View`.
    """

    name: str
    camera: Camera
    image: Tensor
    mask: Tensor | None
    whole: tuple[int, int]
    off_edge: Tensor | None = None
    covered: Tensor | None = None
    invalid: Tensor | None = None
    irradiance: Tensor | None = None
    off_edge_sum: float | None = None  # pixels where off_edge is True
    white: Tensor | None = None

    @property
    def share(self) -> float:
        """Return the view's share of the whole photograph's pixels."""
        width, height = self.whole
        return self.camera.width * self.camera.height / (width * height)

    @property
    def off_edge_share(self) -> float:
        """Return the view's share of those of the whole photograph's pixels that lie away from the mask's contour.

        The contour lies inside the view.
        """
        if self.off_edge_sum is None:
            return 1.0
        outside = self.whole[0] * self.whole[1] - self.camera.width * self.camera.height
        return self.off_edge_sum / max(1.0, self.off_edge_sum + outside)

    def shading(self) -> Tensor | None:
        """Return `irradiance` as [H,W] in 0..1, for `render_gaussians`; None where no flash lit the view."""
        return None if self.irradiance is None else self.irradiance / 255

    def target(self, behind: Tensor) -> Target:
        """Return the photograph on a background [3], for the losses."""
        clipped = None if self.white is None else self.image >= self.white
        if self.mask is None:
            return Target(self.image / 255, None, self.camera, invalid=self.invalid, clipped=clipped, share=self.share)
        if clipped is not None:
            clipped &= (self.mask > 127)[..., None]
        color, alpha, off_edge = composite(self.image, self.mask, behind, self.off_edge)
        edges = off_edge, self.off_edge_sum, self.off_edge_share
        return Target(color, alpha, self.camera, *edges, self.invalid, clipped, self.share)


def prepare_views(
    views: list[View],
    masked: bool,
    margin: int | None = None,
    edge_band: int = 0,
    device: torch.device = CPU,
    reduce: int = 1,
) -> list[TrainingView]:
    """Convert the views to tensors on a device; without `masked`, their alpha is ignored.

    edge_band: the half width, in pixels, of the strip around the masks' contours that `off_edge` leaves out.
    margin: with masks, only the mask's bounding box and this many pixels of the photograph around it are kept.
    reduce: how many pixels along each side are averaged into one; edge_band counts the averaged pixels.
    """
    store = PixelStore(MADE_BYTES)
    return [_prepared(view, masked, margin, edge_band, device, reduce, store) for view in views]


def _prepared(
    view: View,
    masked: bool,
    margin: int | None,
    edge_band: int,
    device: torch.device,
    reduce: int,
    store: PixelStore,
) -> TrainingView:
    if not masked:
        view = replace(view, alpha=None)
    whole = -(-view.camera.width // reduce), -(-view.camera.height // reduce)
    box = None if margin is None or view.alpha is None else bounding_box(view.alpha, margin)
    if box is not None:
        view = view.cropped(*box)
    if reduce > 1:
        view = _held(_reduced(view, reduce), store)
    image = _moved(view.image, device)
    # The host finds the indices, so that it need not wait for a GPU.
    invalid = None if view.valid_mask is None else torch.from_numpy(np.flatnonzero(~view.valid_mask)).to(device)
    irradiance = None if view.irradiance is None else _moved(view.irradiance, device)
    white = None if view.white is None else torch.from_numpy(view.white).to(device)
    if view.alpha is None:
        return TrainingView(
            view.name, view.camera, image, None, whole, invalid=invalid, irradiance=irradiance, white=white
        )
    alpha = view.alpha if view.valid_mask is None else store.hold(np.where(view.valid_mask, view.alpha, np.uint8(0)))
    mask, covered = torch.from_numpy(alpha), torch.from_numpy(store.hold(np.flatnonzero(alpha)))
    off_edge = None
    if edge_band:
        off_edge = torch.from_numpy(store.hold(away_from_contour(mask, edge_band, view.valid_mask).numpy()))
    off_edge_sum = None if off_edge is None else float(off_edge.sum())
    regions = whole, None if off_edge is None else off_edge.to(device), covered.to(device), invalid
    return TrainingView(view.name, view.camera, image, _moved(alpha, device), *regions, irradiance, off_edge_sum, white)


def _held(view: View, store: PixelStore) -> View:
    alpha = None if view.alpha is None else store.hold(view.alpha)
    return replace(view, image=store.hold(view.image), alpha=alpha)


def _moved(pixels: np.ndarray, device: torch.device) -> Tensor:
    """Move pixels [H,W,...] to a device; on the CPU the result shares the scene's memory.

    CUDA kernels read dense memory, so on a GPU the result is contiguous.
    """
    moved = torch.from_numpy(pixels).to(device)
    return moved if device == CPU else moved.contiguous()


def _reduced(view: View, by: int) -> View:
    """Average each by x by pixels of a view into one, with sides rounded up.

    `reduced_view` of `mgsr.data.loading` accepts any scale, but it needs OpenCV, and training must run without it.
    """
    camera = view.camera.resized(-(-view.camera.width // by), -(-view.camera.height // by))

    def mean(pixels: np.ndarray) -> np.ndarray:
        """Return the means [h,w,C] of pixels [H,W,C]."""
        planes = torch.from_numpy(pixels).to(torch.float32).permute(2, 0, 1)
        small = torch.nn.functional.adaptive_avg_pool2d(planes[None], (camera.height, camera.width))[0]
        return small.permute(1, 2, 0).numpy()

    return averaged(view, camera, mean)


def away_from_contour(mask: Tensor, band: int, valid: np.ndarray | None = None) -> Tensor:
    """Return the pixels [H,W] bool that lie farther than `band` pixels from the contour of a mask [H,W] uint8.

    valid [H,W] bool: the valid pixels, None for all. The contour is where the mask passes one half. A diagonal step
    counts as one pixel. Borders between valid and invalid pixels are no contours.
    """
    inside = mask > 127
    outside = ~inside
    if valid is not None:
        shown = torch.from_numpy(valid)
        inside, outside = inside & shown, outside & shown
    near = torch.stack([inside, outside]).to(torch.float32)
    size = 2 * band + 1
    near_inside, near_outside = torch.nn.functional.max_pool2d(near, size, 1, band) > 0
    off: Tensor = ~(near_inside & near_outside)
    return off


def bounding_box(alpha: np.ndarray, margin: int) -> tuple[slice, slice] | None:
    """Return the rows and columns of the bounding box of an alpha image [H,W], with a margin of `margin` pixels.

    The image's border limits the box. Returns None if the image covers nothing.
    """
    rows, columns = np.flatnonzero(alpha.any(axis=1)), np.flatnonzero(alpha.any(axis=0))
    if not len(rows):
        return None
    height, width = alpha.shape
    return (
        slice(max(0, int(rows[0]) - margin), min(height, int(rows[-1]) + 1 + margin)),
        slice(max(0, int(columns[0]) - margin), min(width, int(columns[-1]) + 1 + margin)),
    )


def pick_background(backdrop: Backdrop, generator: torch.Generator) -> Color:
    """Choose the colour behind the splats in one iteration; only a random backdrop uses the generator."""
    if not backdrop.random:
        return backdrop.color
    red, green, blue = torch.rand(3, generator=generator).tolist()
    return (red, green, blue)


def color_tensor(color: Color, device: torch.device) -> Tensor:
    """Return a colour as a tensor [3] on a device, without waiting for the copy."""
    return torch.tensor(color).to(device, non_blocking=True)


class ViewCycle:
    """An endless order of views: each view once an epoch, in an order that the generator shuffles for each epoch."""

    def __init__(self, count: int, generator: torch.Generator) -> None:
        self.count = count
        self.generator = generator
        self.order: list[int] = []

    def next(self) -> int:
        """Return the next view's index."""
        if not self.order:
            self.order = torch.randperm(self.count, generator=self.generator).tolist()
        return self.order.pop()

    @property
    def at_epoch_end(self) -> bool:
        """Return whether the epoch has used every view."""
        return not self.order
