"""The CUDA half of the 3D branch: the same calls as `mgsr.native._volumes`."""

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
STATE_PLANES = {"single": 5, "dual": 10}
PIXEL_PLANES = {"single": 5, "dual": 10}
SPLAT_TENSORS = ("means", "quats", "scales", "opacities", "colors", "refl_opacities", "refl_colors", "weights")


class Splats(ctypes.Structure):
    """VolumeSplats of kernels/volumes/projection_cuda.h."""

    _fields_ = (
        ("count", Long),
        *pointers(*SPLAT_TENSORS),
        ("camera", Camera),
        ("width", Int),
        ("height", Int),
        ("near", Float),
        ("low_pass", Float),
        ("compensate", Int),
    )


class ProjectParams(ctypes.Structure):
    _fields_ = (("in", Splats), *PROJECTED)


class BlendParams(ctypes.Structure):
    _fields_ = (
        ("tiles", Tiles),
        *pointers("records", "background", "color", "alpha", "depth", "reflected", "weight"),
        *pointers("transmittance", "states", "reached"),
    )


class PixelParams(ctypes.Structure):
    _fields_ = (
        ("tiles", Tiles),
        *pointers("transmittance", "color", "depth", "reflected", "weight"),
        *pointers("v_color", "v_alpha", "v_depth", "v_reflected", "v_weight", "planes"),
    )


class BackwardParams(ctypes.Structure):
    _fields_ = (("tiles", Tiles), *pointers("records", "states", "reached", "planes", "pairs"))


class GradientParams(ctypes.Structure):
    _fields_ = (
        ("in", Splats),
        *pointers("records", "radii", "sums", "tile_counts"),
        *pointers(*(f"v_{name}" for name in SPLAT_TENSORS), "v_means2d"),
    )


@dataclass(frozen=True)
class Frame:
    """What backward needs kept from forward; the states only where there will be a backward pass."""

    lists: TileLists
    records: Tensor
    radii: Tensor
    transmittance: Tensor
    states: Tensor | None
    reached: Tensor


class VolumeKernels:
    """Renders and differentiates on one launcher. Arguments as in `mgsr.native._volumes`; keep: whether backward
    will be called for the frame."""

    def __init__(self, launcher: Launcher, keep: bool) -> None:
        self._launcher, self._keep = launcher, keep

    def forward(self, *arguments: Any) -> Frame:
        """Render into the images and radii given, and return what `backward` takes."""
        splats, background, view, images, radii = (
            arguments[:8],
            arguments[8],
            arguments[9:16],
            arguments[16:21],
            arguments[21],
        )
        splats_struct = _splats_struct(splats, view)
        records, _, lists = project(self._launcher, "volumes", ProjectParams, splats_struct, radii)
        kind, transmittance = _kind(splats), background.new_empty(lists.height, lists.width)
        reached, states = lists.ranges.new_empty(lists.tiles), None
        with refusing(lists.pairs):
            if self._keep:
                states = background.new_empty(lists.most_buckets, STATE_PLANES[kind], TILE_PIXELS)
        arrays = (records, background, *images, transmittance, states, reached)
        params = BlendParams(lists.struct(), *(pointer(t) for t in arrays))
        self._launcher.launch("volumes", f"volumes_blend_{kind}", lists.tiles, TILE_PIXELS, params)
        return Frame(lists, records, radii, transmittance, states, reached)

    def backward(self, frame: Frame, *arguments: Any) -> None:
        """Write the splats' gradients from those of the images."""
        assert frame.states is not None, "rendered without a backward pass in mind"
        splats, view = arguments[:8], arguments[9:16]
        images, v_images, v_splats = arguments[16:21], arguments[21:26], arguments[26:]
        kind, lists = _kind(splats), frame.lists
        with refusing(lists.pairs):
            planes = self._prepare_pixels(kind, frame, images, v_images)
            pairs = planes.new_empty(lists.pairs, tiles.PAIR_FIELDS)
        arrays = (frame.records, frame.states, frame.reached, planes, pairs)
        params = BackwardParams(lists.struct(), *(pointer(t) for t in arrays))
        self._launcher.launch("volumes", f"volumes_backward_{kind}", lists.bucket_blocks, BUCKET_THREADS, params)
        sums = sum_pairs(self._launcher, lists, pairs)
        arrays = (frame.records, frame.radii, sums, lists.tile_counts, *v_splats)
        gradients = GradientParams(_splats_struct(splats, view), *(pointer(t) for t in arrays))
        blocks = splat_blocks(len(splats[0]))
        self._launcher.launch("volumes", "volumes_gradients", blocks, SPLAT_THREADS, gradients)

    def _prepare_pixels(self, kind: str, frame: Frame, images: Any, v_images: Any) -> Tensor:
        color, _, depth, reflected, weight = images
        planes = color.new_empty(frame.lists.tiles, PIXEL_PLANES[kind], TILE_PIXELS)
        arrays = (frame.transmittance, color, depth, reflected, weight, *v_images, planes)
        params = PixelParams(frame.lists.struct(), *(pointer(t) for t in arrays))
        self._launcher.launch("volumes", f"volumes_pixels_{kind}", frame.lists.tiles, TILE_PIXELS, params)
        return planes


def _kind(splats: Any) -> str:
    return "single" if splats[5] is None else "dual"


def _splats_struct(splats: Any, view: Any) -> Splats:
    K, cam_from_world, width, height, near, low_pass, compensate = view
    camera = camera_struct(K, cam_from_world, width, height)
    arrays = (pointer(t) for t in splats)
    return Splats(len(splats[0]), *arrays, camera, width, height, near, low_pass, compensate)
