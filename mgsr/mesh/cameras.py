"""The cameras, and image sizes, from which the surface is rendered for its extraction."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from mgsr.config import MeshConfig
from mgsr.data.camera import Camera


def surface_cameras(train_cameras: Sequence[Camera], config: MeshConfig) -> list[Camera]:
    """Return the training cameras and config.extra_views more between neighbours, at the size for surface extraction.

    Each is scaled by config.view_scale, or less where all images together would exceed config.max_pixels.
    """
    cameras = [*train_cameras, *between(train_cameras, config.extra_views)]
    pixels = sum(camera.width * camera.height for camera in cameras)
    scale = min(config.view_scale, (config.max_pixels / max(pixels, 1)) ** 0.5)
    return [
        camera.resized(max(16, round(camera.width * scale)), max(16, round(camera.height * scale)))
        for camera in cameras
    ]


def between(cameras: Sequence[Camera], count: int) -> list[Camera]:
    """Return `count` cameras, each halfway between two neighbours; the most distant neighbours come first.

    Halfway: at the mean distance from the scene's centre, turned halfway, with the first one's intrinsics. Fewer are
    returned where fewer pairs of neighbours exist.
    """
    pairs = _neighbours(cameras)
    return [_halfway(cameras[first], cameras[second]) for first, second in pairs[:count]]


def _neighbours(cameras: Sequence[Camera]) -> list[tuple[int, int]]:
    """Pair each camera with its three nearest, every pair once, the most distant first, by index."""
    centers = np.array([camera.center for camera in cameras]).reshape(-1, 3)
    distances = np.linalg.norm(centers[:, None] - centers[None], axis=-1)
    pairs = {
        (min(first, int(second)), max(first, int(second)))
        for first, row in enumerate(distances)
        for second in np.argsort(row)[1:4]
    }
    return sorted(pairs, key=lambda pair: (-distances[pair], pair))


def _halfway(first: Camera, second: Camera) -> Camera:
    rotations = Rotation.from_matrix([camera.cam_from_world[:3, :3] for camera in (first, second)])
    rotation = Slerp([0, 1], rotations)(0.5).as_matrix()
    middle = (first.center + second.center) / 2
    distance = (np.linalg.norm(first.center) + np.linalg.norm(second.center)) / 2
    if np.linalg.norm(middle) > 0.1 * distance:  # else they face each other, and no direction is between
        middle *= distance / np.linalg.norm(middle)
    pose = np.eye(4)
    pose[:3, :3] = rotation
    pose[:3, 3] = -rotation @ middle
    return Camera(first.K, pose, first.width, first.height)
