"""The CUDA half of the 2D branch: the same calls as `mgsr.native._surfels`."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from functools import partial

from torch import Tensor

from mgsr.native.cuda.bands import add_bands, blend_bands
from mgsr.native.cuda.launcher import Launcher
from mgsr.native.cuda.params import Float, Int, Long, addresses, pointer, pointers
from mgsr.native.cuda.tiles import (
    BUCKET_THREADS,
    PAIR_FIELDS,
    PROJECTED,
    SPLAT_THREADS,
    TILE_PIXELS,
    Band,
    Blended,
    Projected,
    TileLists,
    Tiles,
    list_tiles,
    project,
    splat_blocks,
    sum_pairs,
)
from mgsr.native.cuda.view import CameraStruct, camera_struct
from mgsr.native.structs import SurfelGradients, SurfelImageGradients, SurfelImages, SurfelSplats, SurfelView

# Floats per pixel: the state at the beginning of a bucket, and the prepared inputs of the backward pass.
STATE_PLANES = {"plain": 8, "distortion": 10}
PIXEL_PLANES = {"plain": 9, "distortion": 11}
SPLAT_TENSORS = ("means", "quats", "scales", "opacities", "colors")
DEPTHS = (("near", Float), ("far", Float), ("low_pass", Float))


class SurfelSplatsStruct(ctypes.Structure):
    """The struct SurfelSplats of kernels/surfels/projection_cuda.h."""

    _fields_ = (
        ("count", Long),
        *pointers(*SPLAT_TENSORS),
        ("camera", CameraStruct),
        ("width", Int),
        ("height", Int),
        *DEPTHS,
    )


class SurfelProjectParams(ctypes.Structure):
    _fields_ = (("in", SurfelSplatsStruct), *PROJECTED)


class SurfelBlendParams(ctypes.Structure):
    _fields_ = (
        ("tiles", Tiles),
        *pointers("records", "outlines", "background"),
        *DEPTHS,
        *pointers("color", "alpha", "depth", "median_depth", "normal", "distortion"),
        *pointers("transmittance", "moments", "states", "reached"),
    )


class SurfelPixelParams(ctypes.Structure):
    _fields_ = (
        ("tiles", Tiles),
        *pointers("transmittance", "moments", "color", "depth", "normal"),
        *pointers("v_color", "v_alpha", "v_depth", "v_median_depth", "v_normal", "v_distortion", "planes"),
    )


class SurfelBackwardParams(ctypes.Structure):
    _fields_ = (
        ("tiles", Tiles),
        *pointers("records", "outlines"),
        *DEPTHS,
        *pointers("states"),
        ("state_planes", Int),
        *pointers("reached", "planes", "pairs"),
    )


class SurfelGradientParams(ctypes.Structure):
    _fields_ = (
        ("in", SurfelSplatsStruct),
        *pointers("records", "sums", "tile_counts"),
        *pointers(*(f"v_{name}" for name in SPLAT_TENSORS), "v_means2d"),
    )


@dataclass
class SurfelForwardState:
    """The results of forward that backward needs.

    blended: the blended band, if the image is one band; None once backward has taken it. Backward blends the bands of
    larger images again, one after the other.
    """

    projected: Projected
    transmittance: Tensor
    moments: Tensor | None
    bands: list[Band]
    blended: Blended | None = None

    def take_blended(self) -> Blended | None:
        """Return the kept blended band and release it, to save memory."""
        blended, self.blended = self.blended, None
        return blended


class SurfelKernels:
    """The kernels that render and differentiate surfels on one launcher.

    keep: whether backward will be called for the frame.
    """

    def __init__(self, launcher: Launcher, keep: bool) -> None:
        self._launcher, self._keep = launcher, keep

    def forward(
        self, splats: SurfelSplats, view: SurfelView, images: SurfelImages, radii: Tensor
    ) -> SurfelForwardState:
        """Render into the images and radii [N], and return the state for `backward`.

        Raises GpuError if the GPU's memory is too small.
        """
        projected = project(self._launcher, "surfels", SurfelProjectParams, _splats_struct(splats, view), radii)
        size = (projected.height, projected.width)
        moments = None if images.distortion is None else radii.new_empty(*size, 2)
        frame = SurfelForwardState(projected, radii.new_empty(size), moments, [projected.whole])
        blend = partial(self._blend, frame, splats.background, view, images)
        frame.bands, frame.blended = blend_bands(self._launcher, projected, blend, self._keep)
        return frame

    def backward(
        self,
        frame: SurfelForwardState,
        splats: SurfelSplats,
        view: SurfelView,
        images: SurfelImages,
        v_images: SurfelImageGradients,
        v_splats: SurfelGradients,
    ) -> None:
        """Write the splats' gradients, given those of the images.

        Raises GpuError if the GPU's memory is too small.
        """
        assert self._keep, "the render was made without a backward pass"

        def walk_back(band: Band) -> Tensor:
            """Return the gradients [N,16] of a band's splats."""
            blended = frame.take_blended() or self._blend(frame, splats.background, view, images, band, keep=True)
            return self._walk_back(frame, blended, view, images, v_images)

        sums = add_bands(self._launcher, frame.projected, frame.bands, walk_back)
        arrays = addresses(frame.projected.records, sums, frame.projected.whole.tile_counts, *v_splats)
        gradients = SurfelGradientParams(frame.projected.splats, *arrays)
        blocks = splat_blocks(splats.means.shape[0])
        self._launcher.launch("surfels", "surfels_gradients", blocks, SPLAT_THREADS, gradients)

    def _blend(
        self,
        frame: SurfelForwardState,
        background: Tensor,
        view: SurfelView,
        images: SurfelImages,
        band: Band,
        keep: bool,
    ) -> Blended:
        """Render a band's pixels into the images."""
        lists = list_tiles(self._launcher, frame.projected, band)
        kind = "plain" if images.distortion is None else "distortion"
        reached, states = lists.ranges.new_empty(lists.tiles), None
        if keep:
            states = background.new_empty(lists.most_buckets, STATE_PLANES[kind], TILE_PIXELS)
        arrays = addresses(*images, frame.transmittance, frame.moments, states, reached)
        inputs = addresses(frame.projected.records, frame.projected.outlines, background)
        params = SurfelBlendParams(lists.struct, *inputs, *_depths(view), *arrays)
        self._launcher.launch("surfels", f"surfels_blend_{kind}", lists.tiles, TILE_PIXELS, params)
        return Blended(lists, states, reached)

    def _walk_back(
        self,
        frame: SurfelForwardState,
        blended: Blended,
        view: SurfelView,
        images: SurfelImages,
        v_images: SurfelImageGradients,
    ) -> Tensor:
        """Return the gradients [N,16] of each splat from a band's pixels."""
        assert blended.states is not None
        kind, lists = "plain" if v_images.distortion is None else "distortion", blended.lists
        planes = self._prepare_pixels(kind, frame, lists, images, v_images)
        pairs = planes.new_empty(lists.pairs, PAIR_FIELDS)
        states, state_planes = pointer(blended.states), blended.states.shape[1]
        arrays = addresses(blended.reached, planes, pairs)
        splats = (pointer(frame.projected.records), pointer(frame.projected.outlines))
        params = SurfelBackwardParams(lists.struct, *splats, *_depths(view), states, state_planes, *arrays)
        self._launcher.launch("surfels", f"surfels_backward_{kind}", lists.bucket_blocks, BUCKET_THREADS, params)
        return sum_pairs(self._launcher, lists, pairs)

    def _prepare_pixels(
        self,
        kind: str,
        frame: SurfelForwardState,
        lists: TileLists,
        images: SurfelImages,
        v_images: SurfelImageGradients,
    ) -> Tensor:
        planes = images.color.new_empty(lists.tiles, PIXEL_PLANES[kind], TILE_PIXELS)
        forward = (frame.transmittance, frame.moments, images.color, images.depth, images.normal)
        params = SurfelPixelParams(lists.struct, *addresses(*forward, *v_images, planes))
        self._launcher.launch("surfels", f"surfels_pixels_{kind}", lists.tiles, TILE_PIXELS, params)
        return planes


def _depths(view: SurfelView) -> tuple[float, float, float]:
    """Return the values of DEPTHS."""
    return view.near, view.far, view.low_pass


def _splats_struct(splats: SurfelSplats, view: SurfelView) -> SurfelSplatsStruct:
    camera = view.camera
    arrays = addresses(splats.means, splats.quats, splats.scales, splats.opacities, splats.colors)
    size = (camera.width, camera.height)
    return SurfelSplatsStruct(splats.means.shape[0], *arrays, camera_struct(camera), *size, *_depths(view))
