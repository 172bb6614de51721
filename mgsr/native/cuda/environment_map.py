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
        ("width", Int),
        ("side", Int),
        *pointers("maps", "normals"),
        ("cam_from_world", Float * 9),
        *((name, Float) for name in ("fx", "fy", "cx", "cy")),
        *pointers("light", "v_light", "v_normals", "cells", "places"),
    )


class CellParams(ctypes.Structure):
    _fields_ = (
        ("count", Long),
        *pointers("pixels", "v_light", "places"),
        ("side", Int),
        *pointers("cells", "slots", "sums"),
    )


class TexelParams(ctypes.Structure):
    _fields_ = (("side", Int), *pointers("sums", "v_maps"))


class EnvironmentMapKernels:
    """The kernels of the environment map and its gradients on one launcher."""

    def __init__(self, launcher: Launcher) -> None:
        self._launcher = launcher

    def forward(self, lookup: EnvironmentMapLookup, light: Tensor) -> None:
        """Write light [H,W,3] at the pixels."""
        self._launch_lookup("environment_map_forward", lookup, (light, None, None, None, None))

    def backward(
        self, lookup: EnvironmentMapLookup, v_light: Tensor, v_maps: Tensor | None, v_normals: Tensor | None
    ) -> None:
        """Write v_maps [2,S,S,3] and v_normals [H,W,3] at the pixels, given v_light [H,W,3]; None if not needed."""
        count, normals = _count(lookup), lookup.normals
        cells = places = None
        if v_maps is not None:
            cells, places = normals.new_empty(2 * count, dtype=torch.int32), normals.new_empty(2 * count, 2)
        self._launch_lookup("environment_map_backward", lookup, (None, v_light, v_normals, cells, places))
        if v_maps is not None and cells is not None and places is not None:
            self._add_up(count, lookup.pixels, v_light, cells, places, v_maps)

    def _launch_lookup(self, kernel: str, lookup: EnvironmentMapLookup, arrays: tuple[Tensor | None, ...]) -> None:
        maps, normals, pixels, camera = lookup
        count = _count(lookup)
        inputs = (count, pointer(pixels), normals.shape[1], maps.shape[1], pointer(maps), pointer(normals))
        lens = ((Float * 9)(*camera.cam_from_world[:3, :3].ravel().tolist()), *intrinsics(camera))
        params = EnvironmentMapParams(*inputs, *lens, *addresses(*arrays))
        self._launcher.launch("environment_map", kernel, -(-count // THREADS), THREADS, params)

    def _add_up(
        self, count: int, pixels: Tensor | None, v_light: Tensor, cells: Tensor, places: Tensor, v_maps: Tensor
    ) -> None:
        side = v_maps.shape[1]
        cells, slots = torch.sort(cells, stable=True)
        sums = v_maps.new_empty(2, side, side, CELL_FIELDS)
        inputs = (count, pointer(pixels), pointer(v_light), pointer(places), side)
        params = CellParams(*inputs, *addresses(cells, slots, sums))
        self._launcher.launch(
            "environment_map", "environment_map_cells", -(-2 * side * side * WARP // THREADS), THREADS, params
        )
        texels = TexelParams(side, pointer(sums), pointer(v_maps))
        self._launcher.launch(
            "environment_map", "environment_map_texels", -(-v_maps.numel() // THREADS), THREADS, texels
        )


def _count(lookup: EnvironmentMapLookup) -> int:
    height, width, _ = lookup.normals.shape
    return height * width if lookup.pixels is None else lookup.pixels.shape[0]
