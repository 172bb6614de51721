"""Screened Poisson reconstruction of a surface from oriented points."""

from __future__ import annotations

import numpy as np

from mgsr.config.expert import MeshOptions
from mgsr.geometry.mesh import Mesh
from mgsr.mesh.points import OrientedPoints
from mgsr.open3d_library import load_open3d


def cell_size(extent: float, depth: int, margin: float = MeshOptions().poisson_margin) -> float:
    """Return the size of the finest octree cell for points within a box whose longest side is `extent`.

    margin: the side of the octree's cube, relative to that box.
    """
    size: float = margin * extent / 2**depth
    return size


def poisson_surface(points: OrientedPoints, depth: int, margin: float = MeshOptions().poisson_margin) -> Mesh:
    """Reconstruct the closed surface of oriented points, in their frame.

    depth: the octree's levels. margin: the side of its cube, relative to the points' bounding box.

    It runs on one thread, as several would sum in a different order each time and change the vertices.

    Source: Kazhdan and Hoppe, Screened Poisson Surface Reconstruction (Open3D's build of the authors' code).
    """
    open3d = load_open3d()
    cloud = open3d.geometry.PointCloud()
    cloud.points = open3d.utility.Vector3dVector(points.positions.astype(np.float64))
    cloud.normals = open3d.utility.Vector3dVector(points.normals.astype(np.float64))
    mesh, _ = open3d.geometry.TriangleMesh.create_from_point_cloud_poisson(
        cloud, depth=depth, scale=margin, linear_fit=False, n_threads=1
    )
    return Mesh(np.asarray(mesh.vertices), np.asarray(mesh.triangles).astype(np.int64))


def trim_unsupported(mesh: Mesh, points: OrientedPoints, reach: float) -> Mesh:
    """Drop the faces that have a vertex farther than `reach`, in the scene's unit, from all points."""
    return mesh.keep_faces(points.near(mesh.vertices, reach)[mesh.faces].all(1))
