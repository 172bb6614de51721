"""The cameras and image sizes for rendering the surface before its extraction."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from mgsr.config import MeshConfig
from mgsr.data.camera import Camera

OPPOSITE = 0.1  # of their distance; two cameras whose middle is nearer to the centre are opposite, with no direction
# between them


def surface_cameras(train_cameras: Sequence[Camera], config: MeshConfig) -> list[Camera]:
    """Return the training cameras and up to config.extra_views more between neighbours, sized for surface extraction.

    Each is scaled by config.view_scale, or by less if all images together would exceed config.max_pixels.
    """
    cameras = [*train_cameras, *between(train_cameras, config.extra_views)]
    pixels = sum(camera.width * camera.height for camera in cameras)
    scale = min(config.view_scale, (config.max_pixels / max(pixels, 1)) ** 0.5)
    return [camera.scaled(scale, least=16) for camera in cameras]


def between(cameras: Sequence[Camera], count: int) -> list[Camera]:
    """Return at most `count` cameras, each halfway between two neighbours; the most distant neighbours come first.

    A camera halfway has the mean distance from the scene's centre, the interpolated rotation, and the first neighbour's
    intrinsics.
    """
    pairs = _neighbours(cameras)
    return [_halfway(cameras[first], cameras[second]) for first, second in pairs[:count]]


def _neighbours(cameras: Sequence[Camera]) -> list[tuple[int, int]]:
    """Return the pairs of each camera and its three nearest, as indices, without repeats, the most distant first."""
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
    if np.linalg.norm(middle) > OPPOSITE * distance:
        middle *= distance / np.linalg.norm(middle)
    pose = np.eye(4)
    pose[:3, :3] = rotation
    pose[:3, 3] = -rotation @ middle
    return Camera(first.K, pose, first.width, first.height)
