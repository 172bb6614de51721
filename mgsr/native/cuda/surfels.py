"""The CUDA half of the 2D branch: the same calls as `mgsr.native._surfels`."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from typing import Any

from torch import Tensor

from mgsr.native.cuda import tiles
from mgsr.native.cuda.launcher import Launcher
from mgsr.native.cuda.params import Float, Int, Long, pointer, pointers
from mgsr.native.cuda.tiles import (
    BUCKET_THREADS,
    PROJECTED,
    SPLAT_THREADS,
    TILE_PIXELS,
    TileLists,
    Tiles,
    project,
    refusing,
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
    """SurfelSplats of kernels/surfels/projection_cuda.h."""

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
        *pointers("records"),
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


@dataclass(frozen=True)
class Frame:
    """What backward needs kept from forward; the states only where there will be a backward pass."""

    lists: TileLists
    records: Tensor
    transmittance: Tensor
    moments: Tensor | None
    states: Tensor | None
    reached: Tensor


class SurfelKernels:
    """Renders and differentiates on one launcher. Arguments as in `mgsr.native._surfels`; keep: whether backward
    will be called for the frame."""

    def __init__(self, launcher: Launcher, keep: bool) -> None:
        self._launcher, self._keep = launcher, keep

    def forward(self, *arguments: Any) -> Frame:
        """Render into the images and radii given, and return what `backward` takes."""
        splats, background, view = arguments[:5], arguments[5], arguments[6:13]
        images, radii = arguments[13:19], arguments[19]
        records, outlines, lists = project(
            self._launcher, "surfels", ProjectParams, _splats_struct(splats, view), radii
        )
        kind = "plain" if images[5] is None else "distortion"
        transmittance, reached = radii.new_empty(lists.height, lists.width), lists.ranges.new_empty(lists.tiles)
        moments = None if images[5] is None else radii.new_empty(lists.height, lists.width, 2)
        states = None
        with refusing(lists.pairs):
            if self._keep:
                states = radii.new_empty(lists.most_buckets, STATE_PLANES[kind], TILE_PIXELS)
        arrays = (pointer(t) for t in (*images, transmittance, moments, states, reached))
        inputs = (pointer(t) for t in (records, outlines, background))
        params = BlendParams(lists.struct(), *inputs, *view[4:], *arrays)
        self._launcher.launch("surfels", f"surfels_blend_{kind}", lists.tiles, TILE_PIXELS, params)
        return Frame(lists, records, transmittance, moments, states, reached)

    def backward(self, frame: Frame, *arguments: Any) -> None:
        """Write the splats' gradients from those of the images."""
        splats, view = arguments[:5], arguments[6:13]
        images, v_images, v_splats = arguments[13:19], arguments[19:25], arguments[25:]
        assert frame.states is not None, "rendered without a backward pass in mind"
        kind, lists = "plain" if v_images[5] is None else "distortion", frame.lists
        with refusing(lists.pairs):
            planes = self._prepare_pixels(kind, frame, images, v_images)
            pairs = planes.new_empty(lists.pairs, tiles.PAIR_FIELDS)
        states, state_planes = pointer(frame.states), frame.states.shape[1]
        arrays = (pointer(t) for t in (frame.reached, planes, pairs))
        params = BackwardParams(lists.struct(), pointer(frame.records), *view[4:], states, state_planes, *arrays)
        self._launcher.launch("surfels", f"surfels_backward_{kind}", lists.bucket_blocks, BUCKET_THREADS, params)
        sums = sum_pairs(self._launcher, lists, pairs)
        arrays = (pointer(t) for t in (frame.records, sums, lists.tile_counts, *v_splats))
        gradients = GradientParams(_splats_struct(splats, view), *arrays)
        self._launcher.launch("surfels", "surfels_gradients", splat_blocks(len(splats[0])), SPLAT_THREADS, gradients)

    def _prepare_pixels(self, kind: str, frame: Frame, images: Any, v_images: Any) -> Tensor:
        color, _, depth, _, normal, _ = images
        planes = color.new_empty(frame.lists.tiles, PIXEL_PLANES[kind], TILE_PIXELS)
        arrays = (frame.transmittance, frame.moments, color, depth, normal, *v_images, planes)
        params = PixelParams(frame.lists.struct(), *(pointer(t) for t in arrays))
        self._launcher.launch("surfels", f"surfels_pixels_{kind}", frame.lists.tiles, TILE_PIXELS, params)
        return planes


def _splats_struct(splats: Any, view: Any) -> Splats:
    K, cam_from_world, width, height, *depths = view
    camera = camera_struct(K, cam_from_world, width, height)
    return Splats(len(splats[0]), *(pointer(t) for t in splats), camera, width, height, *depths)
