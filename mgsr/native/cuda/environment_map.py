"""The CUDA half of the environment map: the same calls as `mgsr.native._environment_map`."""

from __future__ import annotations

import ctypes

import torch
from torch import Tensor

from mgsr.native.cuda.launcher import Launcher
from mgsr.native.cuda.params import Float, Int, Long, Pointer, addresses, pointer, pointers

THREADS, WARP, CELL_FIELDS = 128, 32, 12

Intrinsics = tuple[float, float, float, float]


class PixelParams(ctypes.Structure):
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

    def forward(
        self,
        maps: Tensor,
        normals: Tensor,
        pixels: Tensor | None,
        cam_from_world: list[float],
        intrinsics: Intrinsics,
        light: Tensor,
    ) -> None:
        """Write light [H,W,3] at the pixels."""
        arrays = (light, None, None, None, None)
        self._look("environment_map_forward", maps, normals, pixels, cam_from_world, intrinsics, arrays)

    def backward(
        self,
        maps: Tensor,
        normals: Tensor,
        pixels: Tensor | None,
        cam_from_world: list[float],
        intrinsics: Intrinsics,
        v_light: Tensor,
        v_maps: Tensor | None,
        v_normals: Tensor | None,
    ) -> None:
        """Write v_maps [2,S,S,3] and v_normals [H,W,3] at the pixels, each where asked for."""
        count = _count(normals, pixels)
        cells = places = None
        if v_maps is not None:
            cells, places = normals.new_empty(2 * count, dtype=torch.int32), normals.new_empty(2 * count, 2)
        arrays = (None, v_light, v_normals, cells, places)
        self._look("environment_map_backward", maps, normals, pixels, cam_from_world, intrinsics, arrays)
        if v_maps is not None and cells is not None and places is not None:
            self._add_up(count, pixels, v_light, cells, places, v_maps)

    def _look(
        self,
        kernel: str,
        maps: Tensor,
        normals: Tensor,
        pixels: Tensor | None,
        cam_from_world: list[float],
        intrinsics: Intrinsics,
        arrays: tuple[Tensor | None, ...],
    ) -> None:
        count = _count(normals, pixels)
        inputs = (count, pointer(pixels), normals.shape[1], maps.shape[1], pointer(maps), pointer(normals))
        camera = ((Float * 9)(*cam_from_world), *intrinsics)
        params = PixelParams(*inputs, *camera, *addresses(*arrays))
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


def _count(normals: Tensor, pixels: Tensor | None) -> int:
    return normals.shape[0] * normals.shape[1] if pixels is None else pixels.shape[0]
