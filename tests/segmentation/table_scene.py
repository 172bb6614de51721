"""A capture without masks whose object is known: a spotted ball on a pillar, on a grained table, before a wall."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mgsr.data.camera import Camera
from mgsr.data.scene import Scene, Similarity, View

TABLE, WALL = -0.8, 4.0  # the table's height, and the radius of the round wall
BALL, BALL_RADIUS = np.array([0.0, 0.0, 0.2]), 0.45
PILLAR_RADIUS = 0.2  # of an upright cylinder from the table into the ball
APART = np.array([0.0, 0.6, 0.0])  # of two objects from the middle between them


def table_scene(
    size: int = 96, views: int = 20, copies: int = 1, standing: bool = True, shift: float = 0.0
) -> tuple[Scene, list[np.ndarray]]:
    """Return the scene, without masks, and the object's true masks [H,W] bool in its views.

    copies: 2 puts two objects on the table, the middle between them, 0 none; standing: whether there is an object and a
    table at all, else only the wall is there; shift: moves the cameras' aim sideways, so that images cut it off.
    """
    cameras = [_camera(i, views, size, shift) for i in range(views)]
    drawn = [_drawn(camera, copies, standing) for camera in cameras]
    images = [image for image, _ in drawn]
    shown = [View(f"v{i:02d}", *pair) for i, pair in enumerate(zip(cameras, images, strict=True))]
    scene = Scene("table", Path("."), "plain", shown[: views - 2], shown[views - 2 :], None, Similarity())
    return scene, [mask for _, mask in drawn]


def _camera(index: int, count: int, size: int, shift: float) -> Camera:
    turn, height = 2 * np.pi * index * 7 / count, 0.5 + 0.8 * (index % 3)
    center = np.array([2.6 * np.cos(turn), 2.6 * np.sin(turn), height])
    forward = np.array([0.0, 0.0, -0.15]) + shift * np.array([-np.sin(turn), np.cos(turn), 0.0]) - center
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward])
    pose[:3, 3] = -pose[:3, :3] @ center
    focal = 0.95 * size
    return Camera(np.array([[focal, 0, size / 2], [0, focal, size / 2], [0, 0, 1.0]]), pose, size, size)


def _drawn(camera: Camera, copies: int, standing: bool) -> tuple[np.ndarray, np.ndarray]:
    rows, columns = np.mgrid[: camera.height, : camera.width] + 0.5
    local = np.stack([(columns - camera.K[0, 2]) / camera.K[0, 0], (rows - camera.K[1, 2]) / camera.K[1, 1]], -1)
    rays = np.concatenate([local, np.ones_like(local[..., :1])], -1) @ camera.cam_from_world[:3, :3]
    origin = camera.center
    nearest = _wall(origin, rays)
    colors = _spots(origin + nearest[..., None] * rays, 2.5, (0.55, 0.6, 0.68), (0.38, 0.42, 0.5))
    mask = np.zeros(nearest.shape, bool)
    if standing:
        table = np.where(rays[..., 2] < 0, (TABLE - origin[2]) / np.minimum(rays[..., 2], -1e-9), np.inf)
        places = origin + np.where(np.isfinite(table), table, 0)[..., None] * rays
        table = np.where(np.linalg.norm(places[..., :2], axis=-1) < 1.8, table, np.inf)
        colors = np.where((table < nearest)[..., None], _spots(places, 5, (0.7, 0.5, 0.3), (0.5, 0.33, 0.18)), colors)
        nearest = np.minimum(nearest, table)
        for shift in {0: (), 1: (np.zeros(3),), 2: (-APART, APART)}[copies]:
            hit = np.minimum(_ball(origin - shift, rays), _pillar(origin - shift, rays))
            places = origin + np.where(np.isfinite(hit), hit, 0)[..., None] * rays
            colors = np.where((hit < nearest)[..., None], _spots(places, 6, (0.95, 0.95, 0.9), (0.1, 0.3, 0.6)), colors)
            mask, nearest = np.where(hit < nearest, True, mask), np.minimum(nearest, hit)
    return (255 * colors).round().astype(np.uint8), mask


def _spots(places: np.ndarray, frequency: float, one: tuple[float, ...], other: tuple[float, ...]) -> np.ndarray:
    """Return smooth two-coloured patterns [H,W,3] at places [H,W,3]."""
    x, y, z = (frequency * places[..., i] for i in range(3))
    share = 0.5 + 0.5 * np.tanh(3 * (np.sin(x + 1.3 * np.sin(y)) + np.sin(1.7 * y + z) + np.sin(1.3 * z - 0.6 * x)) / 2)
    return np.asarray(share[..., None] * np.array(one) + (1 - share[..., None]) * np.array(other))


def _wall(origin: np.ndarray, rays: np.ndarray) -> np.ndarray:
    return _roots(rays, origin, WALL)[1]


def _ball(origin: np.ndarray, rays: np.ndarray) -> np.ndarray:
    return _roots(rays, origin - BALL, BALL_RADIUS)[0]


def _pillar(origin: np.ndarray, rays: np.ndarray) -> np.ndarray:
    hit = _roots(rays[..., :2], origin[:2], PILLAR_RADIUS)[0]
    heights = origin[2] + np.where(np.isfinite(hit), hit, 0) * rays[..., 2]
    return np.where((heights > TABLE) & (heights < BALL[2]), hit, np.inf)


def _roots(rays: np.ndarray, origin: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Return where rays enter and leave a ball or cylinder around 0; infinite where they miss it."""
    a, b = (rays * rays).sum(-1), (rays * origin).sum(-1)
    square = b * b - a * (origin @ origin - radius * radius)
    root = np.sqrt(np.maximum(square, 0))
    return tuple(np.where(square > 0, (-b + sign * root) / a, np.inf) for sign in (-1, 1))  # type: ignore[return-value]
