"""Photographs of a ball: a mirror's, and a painted one's."""

from __future__ import annotations

import numpy as np

from mgsr.data.images import linear_to_srgb
from mgsr.data.scene import View
from mgsr.geometry.raycast import pixel_rays
from mgsr.mesh.pixels import back_project
from mgsr.mesh.views import SurfaceView
from tests.mesh.shapes import ball, cameras_around, views_of
from tests.shading.painted import painted

RADIUS = 0.7
VIEWS = 24


def room(directions: np.ndarray) -> np.ndarray:
    """Return coloured light [...,3] from directions [...,3]."""
    axes = np.array([[0.6, 0.8, 0.0], [0.0, 0.6, 0.8], [0.8, 0.0, 0.6]])
    return np.asarray((0.5 + 0.45 * np.sin(7 * directions @ axes.T + np.arange(3))) ** 2)


def mirror_photographs(side: int) -> list[View]:
    """Photograph a ball that mirrors a coloured room, and nothing else, in images of `side` pixels."""
    return [_photograph(index, seen, linear_to_srgb(room(_mirrored(seen)))) for index, seen in _seen(side)]


def painted_photographs(side: int) -> list[View]:
    """Photograph a ball with matte paint, in images of `side` pixels."""
    return [_photograph(index, seen, painted(back_project(seen))) for index, seen in _seen(side)]


def _seen(side: int) -> list[tuple[int, SurfaceView]]:
    return list(enumerate(views_of(ball(RADIUS), cameras_around(VIEWS, side=side))))


def _mirrored(seen: SurfaceView) -> np.ndarray:
    """Return the directions [H,W,3] from which a view's pixels mirror light."""
    rays = pixel_rays(seen.camera)
    directions = rays - 2 * (rays * seen.normal).sum(-1, keepdims=True) * seen.normal
    return np.asarray(directions / np.linalg.norm(directions, axis=-1, keepdims=True))


def _photograph(index: int, seen: SurfaceView, shown: np.ndarray) -> View:
    image = (255 * shown * seen.alpha[..., None]).round().astype(np.uint8)
    return View(str(index), seen.camera, image, (255 * seen.alpha).astype(np.uint8))
