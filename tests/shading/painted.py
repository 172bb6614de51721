"""A paint that parallax can follow, and photographs of it under a flash."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import trimesh

from mgsr.data.camera import Camera
from mgsr.data.images import linear_to_srgb, srgb_to_linear
from mgsr.data.photograph import Photograph
from mgsr.data.scene import View
from mgsr.geometry.raycast import pixel_rays
from mgsr.mesh.pixels import back_project
from mgsr.shading.lighting import lamp_light
from tests.mesh.shapes import cameras_around, views_of

SIDE = 128
PIXEL = 3.0 / (1.3 * SIDE)  # what one covers at the middle of what is photographed

Paint = Callable[[np.ndarray], np.ndarray]  # points [...,3] -> colours [...,3]


def painted(points: np.ndarray) -> np.ndarray:
    """Return a paint [...,3] that changes over some six pixels, and differently along every axis."""
    waves = np.sin(points @ (np.array([[47, 11, 5], [-9, 43, 13], [7, -15, 45.0]]).T))
    colors: np.ndarray = 0.5 + 0.25 * waves
    return colors


def flash_photographs(mesh: trimesh.Trimesh, paint: Paint) -> list[View]:
    """Photograph a mesh with 40 cameras around, under a lamp beside the lens.

    Walls are painted and lit on both sides.
    """
    views = []
    for index, seen in enumerate(views_of(mesh, cameras_around(40, side=SIDE))):
        points = back_project(seen)
        lamp = seen.camera.center + np.array([0.2, -0.1]) @ seen.camera.cam_from_world[:2, :3]
        away = (seen.normal * pixel_rays(seen.camera)).sum(axis=-1, keepdims=True) > 0
        light = (
            8
            * lamp_light(lamp - points, np.where(away, -seen.normal, seen.normal))[..., None]
            * srgb_to_linear(0.8 * paint(points))
        )
        image = (255 * np.clip(linear_to_srgb(light) * seen.alpha[..., None], 0, 1)).round().astype(np.uint8)
        views.append(View(str(index), seen.camera, image, (255 * seen.alpha).astype(np.uint8)))
    return views


def as_photograph(camera: Camera, brightness: np.ndarray) -> Photograph:
    """Return a photograph of this brightness [H,W], in linear light, that is not rounded to bytes."""
    grey = 255 * linear_to_srgb(brightness)
    return Photograph(View("v", camera, np.repeat(grey[..., None], 3, axis=-1)))
