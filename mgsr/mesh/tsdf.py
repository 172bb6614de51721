"""TSDF fusion of depth maps on a sparse voxel grid, as in the MGSR paper."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from mgsr.geometry.mesh import Mesh
from mgsr.mesh.pixels import PixelRules, surface_pixels
from mgsr.mesh.views import SurfaceView
from mgsr.open3d_library import load_open3d

BLOCK = 16  # voxels along a block's edge
BLOCKS = 4000  # blocks for which memory is reserved at first; the grid grows beyond


def tsdf_surface(
    views: Sequence[SurfaceView], voxel: float, truncation: float, min_weight: float, rules: PixelRules
) -> Mesh:
    """Fuse the views' depth maps, and return the zero level set, in their frame; empty if no view shows a surface.

    voxel: the size of a voxel, in the scene's unit. truncation: in voxels. min_weight: the least number of views that
    see a voxel.
    """
    grid = _empty_grid(voxel)
    for view in views:
        _integrate(grid, view, voxel, truncation, rules)
    if grid.hashmap().size() == 0:
        return Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int64))
    try:
        mesh = grid.extract_triangle_mesh(weight_threshold=min_weight).to_legacy()
    except RuntimeError as error:
        # Open3D raises this error for a surface without vertices.
        if "SetVertexColors" not in str(error):
            raise
        return Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int64))
    return Mesh(np.asarray(mesh.vertices), np.asarray(mesh.triangles).astype(np.int64))


def _empty_grid(voxel: float) -> Any:
    open3d = load_open3d()
    single = open3d.core.float32
    return open3d.t.geometry.VoxelBlockGrid(("tsdf", "weight"), (single, single), ((1), (1)), voxel, BLOCK, BLOCKS)


def _integrate(grid: Any, view: SurfaceView, voxel: float, truncation: float, rules: PixelRules) -> None:
    open3d = load_open3d()
    depth = np.where(surface_pixels(view, rules).believed, view.depth, 0).astype(np.float32)
    if not depth.any():
        return
    image = open3d.t.geometry.Image(open3d.core.Tensor(depth))
    intrinsic = open3d.core.Tensor(view.camera.K)
    extrinsic = open3d.core.Tensor(view.camera.cam_from_world)
    limits = {"depth_scale": 1.0, "depth_max": float(depth.max()) + voxel, "trunc_voxel_multiplier": float(truncation)}
    blocks = grid.compute_unique_block_coordinates(image, intrinsic, extrinsic, **limits)
    grid.integrate(blocks, image, intrinsic, extrinsic, **limits)
