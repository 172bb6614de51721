"""A capture with exact poses and many features: a patterned ball on the floor of a patterned room."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mgsr.data.camera import Camera
from mgsr.data.scene import Scene, Similarity, View

WIDTH, HEIGHT, FOCAL = 320, 240, 330.0
DISTANCE, RADIUS = 3.0, 0.7  # of the cameras from the ball's middle, and of the ball
FLOOR, WALL = -0.7, 5.0
RING = 14  # cameras of a ring; two rings


def azimuth(index: int) -> float:
    """Return the direction, degrees, in which a photograph's camera stands."""
    return 360.0 * (index % RING + 0.5 * (index // RING)) / RING


def room_cameras() -> list[Camera]:
    """Return the cameras of two rings, of which the second stands higher."""
    return [ring_camera(azimuth(index), 12.0 if index < RING else 40.0) for index in range(2 * RING)]


def ring_camera(turn: float, elevation: float) -> Camera:
    """Return a camera that looks at the ball from these angles, degrees."""
    turn, elevation = np.radians(turn), np.radians(elevation)
    center = DISTANCE * np.array(
        [np.cos(turn) * np.cos(elevation), np.sin(turn) * np.cos(elevation), np.sin(elevation)]
    )
    forward = -center / DISTANCE
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward])
    pose[:3, 3] = -pose[:3, :3] @ center
    K = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1.0]])
    return Camera(K, pose, WIDTH, HEIGHT)


@dataclass(frozen=True)
class Room:
    """The photographs of the room, named 000, 001 and so on, and the ball's true masks [H,W] uint8."""

    views: list[View]
    masks: list[np.ndarray]

    @classmethod
    def drawn(cls) -> Room:
        """Return the room as the cameras of both rings see it."""
        cameras = room_cameras()
        drawn = [photograph(camera) for camera in cameras]
        views = [View(f"{i:03d}", camera, drawn[i][0]) for i, camera in enumerate(cameras)]
        return cls(views, [255 * mask.astype(np.uint8) for _, mask in drawn])


def room_scene(views: list[View]) -> Scene:
    """Return the photographs as a scene; the last four are for tests."""
    return Scene("room", Path("."), "plain", views[:-4], views[-4:], None, Similarity())


def moved(view: View, turn: float, shift: np.ndarray) -> View:
    """Return the view with its camera turned about the upright axis, in degrees, and then shifted [3]."""
    angle = np.radians(turn)
    motion = np.eye(4)
    motion[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    motion[:3, 3] = shift
    pose = view.camera.cam_from_world @ np.linalg.inv(motion)
    return replace(view, camera=replace(view.camera, cam_from_world=pose))


def photograph(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Return a photograph [H,W,3] uint8, of which each pixel is the mean of four rays, and the ball's mask [H,W]."""
    rows, columns = (np.mgrid[: 2 * HEIGHT, : 2 * WIDTH] + 0.5) / 2
    local = np.stack([(columns - camera.K[0, 2]) / camera.K[0, 0], (rows - camera.K[1, 2]) / camera.K[1, 1]], -1)
    rays = np.concatenate([local, np.ones_like(local[..., :1])], -1) @ camera.cam_from_world[:3, :3]
    origin = camera.center
    with np.errstate(divide="ignore"):
        far = (np.where(rays > 0, WALL, [-WALL, -WALL, FLOOR]) - origin) / rays
    room = far.min(axis=-1)
    a, b = (rays * rays).sum(-1), (rays @ origin)
    square = b * b - a * (origin @ origin - RADIUS**2)
    ball = np.where(square > 0, (-b - np.sqrt(np.maximum(square, 0))) / a, np.inf)
    hit = np.isfinite(ball)
    places = origin + np.where(hit, ball, room)[..., None] * rays
    colors = np.where(hit[..., None], _pattern(places, 9.0, 1), _pattern(places, 3.0, 2))
    halves = (HEIGHT, 2, WIDTH, 2)
    image = colors.reshape(*halves, 3).mean(axis=(1, 3))
    return image.round().astype(np.uint8), hit.reshape(halves).mean(axis=(1, 3)) > 0.5


def _pattern(places: np.ndarray, frequency: float, seed: int) -> np.ndarray:
    """Return colours [H,W,3], 0..255, of cells of two sizes whose shades never repeat."""
    return np.asarray((_cells(places * frequency, seed) + _cells(places * frequency / 2.7 + 0.4, seed + 10)) / 2)


def _cells(places: np.ndarray, seed: int) -> np.ndarray:
    whole = np.floor(places).astype(np.int64).astype(np.uint64)
    primes = np.array([73856093, 19349663, 83492791], np.uint64)
    mixed = np.bitwise_xor.reduce(whole * primes, axis=-1)
    shades = [((mixed * np.uint64(2654435761 + 2 * seed + k)) >> np.uint64(13)) % np.uint64(256) for k in range(3)]
    return np.stack(shades, axis=-1).astype(np.float64)
