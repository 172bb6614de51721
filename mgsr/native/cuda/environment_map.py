"""The CUDA half of the environment map: the same calls as `mgsr.native._environment_map`."""

from __future__ import annotations

import ctypes

import torch
from torch import Tensor

from mgsr.native.cuda.launcher import Launcher
from mgsr.native.cuda.params import Float, Int, Long, Pointer, addresses, pointer, pointers
from mgsr.native.cuda.view import intrinsics
from mgsr.native.structs import EnvironmentMapLookup

THREADS, WARP, CELL_FIELDS = 128, 32, 12


class EnvironmentMapParams(ctypes.Structure):
    """The struct EnvironmentMapParams of kernels/environment_map/environment_map.cu."""

    _fields_ = (
        ("count", Long),
        ("pixels", Pointer),
        *((name, Int) for name in ("width", "side", "samples")),
        *pointers("maps", "normals"),
        ("cam_from_world", Float * 9),
        *((name, Float) for name in ("fx", "fy", "cx", "cy")),
        *pointers("light", "v_light", "v_normals", "cells", "places", "weights"),
    )


class CellParams(ctypes.Structure):
    _fields_ = (
        ("count", Long),
        *((name, Int) for name in ("side", "per_pixel")),
        *pointers("pixels", "v_light", "weights", "places", "cells", "slots", "sums"),
    )


class TexelParams(ctypes.Structure):
    _fields_ = (("side", Int), *pointers("sums", "v_maps"))


class EnvironmentMapKernels:
    """The kernels of the environment map and its gradients on one launcher."""

    def __init__(self, launcher: Launcher) -> None:
        self._launcher = launcher

    def forward(self, lookup: EnvironmentMapLookup, light: Tensor) -> None:
        """Write light [H,W,3] at the pixels."""
        self._launch_lookup("environment_map_forward", lookup, _pixel_count(lookup), (light, *[None] * 5))

    def backward(
        self, lookup: EnvironmentMapLookup, v_light: Tensor, v_maps: Tensor | None, v_normals: Tensor | None
    ) -> None:
        """Write v_maps [2,S,S,3] and v_normals [H,W,3] at the pixels, given v_light [H,W,3]; None if not needed."""
        kernel, count = "environment_map_backward", _sample_count(lookup)
        if v_maps is None:
            self._launch_lookup(kernel, lookup, count, (None, v_light, v_normals, None, None, None))
            return
        side = v_maps.shape[1]
        cells, places = v_maps.new_empty(2 * count, dtype=torch.int32), v_maps.new_empty(2 * count, 2)
        weights, sums = v_maps.new_empty(count), v_maps.new_empty(2, side, side, CELL_FIELDS)
        self._launch_lookup(kernel, lookup, count, (None, v_light, v_normals, cells, places, weights))
        cells, slots = torch.sort(cells, stable=True)
        per_pixel = 1 if lookup.samples is None else lookup.samples.shape[1] ** 2
        arrays = addresses(lookup.pixels, v_light, weights, places, cells, slots, sums)
        self._launcher.launch(
            "environment_map",
            "environment_map_cells",
            -(-2 * side * side * WARP // THREADS),
            THREADS,
            CellParams(count, side, per_pixel, *arrays),
        )
        texels = TexelParams(side, *addresses(sums, v_maps))
        self._launcher.launch(
            "environment_map", "environment_map_texels", -(-v_maps.numel() // THREADS), THREADS, texels
        )

    def _launch_lookup(
        self, kernel: str, lookup: EnvironmentMapLookup, threads: int, arrays: tuple[Tensor | None, ...]
    ) -> None:
        maps, normals, samples, pixels, camera = lookup
        seen, rows = (normals, 0) if samples is None else (samples, samples.shape[1])
        inputs = (_pixel_count(lookup), pointer(pixels), camera.width, maps.shape[1], rows, *addresses(maps, seen))
        lens = ((Float * 9)(*camera.cam_from_world[:3, :3].ravel().tolist()), *intrinsics(camera))
        params = EnvironmentMapParams(*inputs, *lens, *addresses(*arrays))
        self._launcher.launch("environment_map", kernel, -(-threads // THREADS), THREADS, params)


def _pixel_count(lookup: EnvironmentMapLookup) -> int:
    """Return the number of pixels to compute."""
    return lookup.camera.height * lookup.camera.width if lookup.pixels is None else lookup.pixels.shape[0]


def _sample_count(lookup: EnvironmentMapLookup) -> int:
    """Return the number of normals in all pixels to compute."""
    return _pixel_count(lookup) if lookup.samples is None else lookup.samples.shape[:3].numel()
