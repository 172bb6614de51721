"""Rendered views of shapes that are known exactly, made by the ray caster."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import trimesh

from mgsr.data.camera import Camera
from mgsr.data.silhouettes import Silhouette, signed_distance
from mgsr.geometry.mesh import Mesh
from mgsr.geometry.raycast import pixel_rays
from mgsr.mesh.views import SurfaceView


def looking_at_origin(center: np.ndarray, side: int = 96, focal: float = 1.3) -> Camera:
    """Return a camera at `center` that looks at the origin.

    Its principal point lies off the middle, and its focal lengths differ.
    """
    forward = -center / np.linalg.norm(center)
    right = np.cross(forward, [0.1, 0.2, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, -rotation @ center
    K = np.array([[focal * side, 0, 0.52 * side], [0, 1.05 * focal * side, 0.47 * side], [0, 0, 1]])
    return Camera(K, pose, side, side)


def cameras_around(count: int, distance: float = 3.0, side: int = 96) -> list[Camera]:
    """Return cameras spread over a sphere (a Fibonacci lattice)."""
    heights = 1 - (2 * np.arange(count) + 1) / count
    angles = np.arange(count) * np.pi * (3 - 5**0.5)
    flat = np.sqrt(1 - heights**2)
    centers = distance * np.stack([flat * np.cos(angles), flat * np.sin(angles), heights], axis=1)
    return [looking_at_origin(center, side) for center in centers]


def position_color(points: np.ndarray) -> np.ndarray:
    """Return the colour that every shape has at places [...,3]."""
    return np.clip(0.5 + 0.4 * points, 0, 1)


def views_of(mesh: trimesh.Trimesh, cameras: Sequence[Camera]) -> list[SurfaceView]:
    """Return what the cameras see of a mesh, without any error."""
    caster = as_mesh(mesh).caster
    views = []
    for camera in cameras:
        hits = caster.cast(camera)
        places = camera.center + pixel_rays(camera) * hits.depth[..., None]
        color = position_color(places).astype(np.float32)
        views.append(SurfaceView(camera, hits.depth, hits.normal, hits.mask.astype(np.float32), color))
    return views


def silhouettes_of(mesh: trimesh.Trimesh, cameras: Sequence[Camera]) -> list[Silhouette]:
    caster = as_mesh(mesh).caster
    return [Silhouette(camera, signed_distance(caster.cast(camera).mask.astype(np.float32))) for camera in cameras]


def as_mesh(shape: trimesh.Trimesh) -> Mesh:
    """Return trimesh's mesh as one of the library."""
    return Mesh(np.asarray(shape.vertices), np.asarray(shape.faces))


def ball(radius: float = 0.7) -> trimesh.Trimesh:
    sphere: trimesh.Trimesh = trimesh.creation.icosphere(subdivisions=5, radius=radius)
    return sphere


def joined(*meshes: trimesh.Trimesh) -> trimesh.Trimesh:
    """Return one mesh of the parts."""
    whole = trimesh.util.concatenate(list(meshes))
    assert isinstance(whole, trimesh.Trimesh)
    return whole
