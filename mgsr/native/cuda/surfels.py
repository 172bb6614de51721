"""The CUDA half of the 2D branch: the same calls as `mgsr.native._surfels`."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from functools import partial
from typing import Any

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
from mgsr.native.cuda.view import Camera, camera_struct

# Floats kept of each pixel at the begin of a bucket, and made ready of each pixel for the backward pass.
STATE_PLANES = {"plain": 8, "distortion": 10}
PIXEL_PLANES = {"plain": 9, "distortion": 11}
SPLAT_TENSORS = ("means", "quats", "scales", "opacities", "colors")
DEPTHS = (("near", Float), ("far", Float), ("low_pass", Float))


class Splats(ctypes.Structure):
    """The struct SurfelSplats of kernels/surfels/projection_cuda.h."""

    _fields_ = (
        ("count", Long),
        *pointers(*SPLAT_TENSORS),
        ("camera", Camera),
        ("width", Int),
        ("height", Int),
        *DEPTHS,
    )


class ProjectParams(ctypes.Structure):
    _fields_ = (("in", Splats), *PROJECTED)


class BlendParams(ctypes.Structure):
    _fields_ = (
        ("tiles", Tiles),
        *pointers("records", "outlines", "background"),
        *DEPTHS,
        *pointers("color", "alpha", "depth", "median_depth", "normal", "distortion"),
        *pointers("transmittance", "moments", "states", "reached"),
    )


class PixelParams(ctypes.Structure):
    _fields_ = (
        ("tiles", Tiles),
        *pointers("transmittance", "moments", "color", "depth", "normal"),
        *pointers("v_color", "v_alpha", "v_depth", "v_median_depth", "v_normal", "v_distortion", "planes"),
    )


class BackwardParams(ctypes.Structure):
    _fields_ = (
        ("tiles", Tiles),
        *pointers("records", "outlines"),
        *DEPTHS,
        *pointers("states"),
        ("state_planes", Int),
        *pointers("reached", "planes", "pairs"),
    )


class GradientParams(ctypes.Structure):
    _fields_ = (
        ("in", Splats),
        *pointers("records", "sums", "tile_counts"),
        *pointers(*(f"v_{name}" for name in SPLAT_TENSORS), "v_means2d"),
    )


@dataclass
class Frame:
    """What backward needs kept from forward.

    blended: of the one band that most images are, until backward takes it; bands of an image too large for that are
    blended again in backward, one after the other.
    """

    projected: Projected
    transmittance: Tensor
    moments: Tensor | None
    bands: list[Band]
    blended: Blended | None = None

    def take_blended(self) -> Blended | None:
        """Return the blended band that is kept, and keep it no longer: memory may be short."""
        blended, self.blended = self.blended, None
        return blended


class SurfelKernels:
    """The kernels that render and differentiate surfels on one launcher.

    Arguments as in `mgsr.native._surfels`; keep: whether backward will be called for the frame.
    """

    def __init__(self, launcher: Launcher, keep: bool) -> None:
        self._launcher, self._keep = launcher, keep

    def forward(self, *arguments: Any) -> Frame:
        """Render into the images and radii given, and return what `backward` takes.

        Raises GpuError where the card's memory is too small.
        """
        splats, background, view = arguments[:5], arguments[5], arguments[6:13]
        images, radii = arguments[13:19], arguments[19]
        projected = project(self._launcher, "surfels", ProjectParams, _splats_struct(splats, view), radii)
        size = (projected.height, projected.width)
        moments = None if images[5] is None else radii.new_empty(*size, 2)
        frame = Frame(projected, radii.new_empty(size), moments, [projected.whole])
        blend = partial(self._blend, frame, background, view, images)
        frame.bands, frame.blended = blend_bands(self._launcher, projected, blend, self._keep)
        return frame

    def backward(self, frame: Frame, *arguments: Any) -> None:
        """Write the splats' gradients from those of the images.

        Raises GpuError where the card's memory is too small.
        """
        assert self._keep, "the render was made without a backward pass"
        splats, background, view = arguments[:5], arguments[5], arguments[6:13]
        images, v_images, v_splats = arguments[13:19], arguments[19:25], arguments[25:]

        def walk_back(band: Band) -> Tensor:
            """Return the gradients [N,16] of a band's splats."""
            blended = frame.take_blended() or self._blend(frame, background, view, images, band, keep=True)
            return self._walk_back(frame, blended, view, images, v_images)

        sums = add_bands(self._launcher, frame.projected, frame.bands, walk_back)
        arrays = addresses(frame.projected.records, sums, frame.projected.whole.tile_counts, *v_splats)
        gradients = GradientParams(frame.projected.splats, *arrays)
        self._launcher.launch(
            "surfels", "surfels_gradients", splat_blocks(splats[0].shape[0]), SPLAT_THREADS, gradients
        )

    def _blend(self, frame: Frame, background: Tensor, view: Any, images: Any, band: Band, keep: bool) -> Blended:
        """Draw a band's pixels into the images."""
        lists = list_tiles(self._launcher, frame.projected, band)
        kind = "plain" if images[5] is None else "distortion"
        reached, states = lists.ranges.new_empty(lists.tiles), None
        if keep:
            states = background.new_empty(lists.most_buckets, STATE_PLANES[kind], TILE_PIXELS)
        arrays = addresses(*images, frame.transmittance, frame.moments, states, reached)
        inputs = addresses(frame.projected.records, frame.projected.outlines, background)
        params = BlendParams(lists.struct, *inputs, *view[4:], *arrays)
        self._launcher.launch("surfels", f"surfels_blend_{kind}", lists.tiles, TILE_PIXELS, params)
        return Blended(lists, states, reached)

    def _walk_back(self, frame: Frame, blended: Blended, view: Any, images: Any, v_images: Any) -> Tensor:
        """Return the gradients [N,16] of each splat from a band's pixels."""
        assert blended.states is not None
        kind, lists = "plain" if v_images[5] is None else "distortion", blended.lists
        planes = self._prepare_pixels(kind, frame, lists, images, v_images)
        pairs = planes.new_empty(lists.pairs, PAIR_FIELDS)
        states, state_planes = pointer(blended.states), blended.states.shape[1]
        arrays = addresses(blended.reached, planes, pairs)
        splats = (pointer(frame.projected.records), pointer(frame.projected.outlines))
        params = BackwardParams(lists.struct, *splats, *view[4:], states, state_planes, *arrays)
        self._launcher.launch("surfels", f"surfels_backward_{kind}", lists.bucket_blocks, BUCKET_THREADS, params)
        return sum_pairs(self._launcher, lists, pairs)

    def _prepare_pixels(self, kind: str, frame: Frame, lists: TileLists, images: Any, v_images: Any) -> Tensor:
        color, _, depth, _, normal, _ = images
        planes: Tensor = color.new_empty(lists.tiles, PIXEL_PLANES[kind], TILE_PIXELS)
        arrays = (frame.transmittance, frame.moments, color, depth, normal, *v_images, planes)
        params = PixelParams(lists.struct, *addresses(*arrays))
        self._launcher.launch("surfels", f"surfels_pixels_{kind}", lists.tiles, TILE_PIXELS, params)
        return planes


def _splats_struct(splats: Any, view: Any) -> Splats:
    K, cam_from_world, width, height, *depths = view
    camera = camera_struct(K, cam_from_world, width, height)
    return Splats(splats[0].shape[0], *addresses(*splats), camera, width, height, *depths)
