"""Small scenes that are hard to train on, each with a known surface, ray-cast by numpy: a ball under bad light."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mgsr.data.camera import Camera
from mgsr.data.scene import Scene, Similarity, View
from mgsr.start.points import StartingPoints, StartSource

RADIUS, DISTANCE, SAMPLES = 0.6, 2.6, 2
Spheres = tuple[np.ndarray, np.ndarray]  # centres [S,3] and radii [S]
BALL: Spheres = (np.zeros((1, 3)), np.array([RADIUS]))


@dataclass(frozen=True)
class Hit:
    """The surface's points [P,3] that rays hit, outward normals [P,3], and unit directions to the camera [P,3]."""

    points: np.ndarray
    normals: np.ndarray
    to_camera: np.ndarray


def textured(hit: Hit) -> np.ndarray:
    colors: np.ndarray = 0.5 + 0.4 * np.sin(hit.points * [9.0, 7.0, 5.0] + [0.0, 1.0, 2.0])
    return colors


def flashed(hit: Hit) -> np.ndarray:
    """Return the colours of a surface under a lamp on the camera, with a highlight."""
    cosine = (hit.normals * hit.to_camera).sum(-1, keepdims=True).clip(0, 1)
    colors: np.ndarray = textured(hit) * cosine**2 + 0.6 * cosine**60
    return colors


def mirrored(hit: Hit) -> np.ndarray:
    """Return the colours of a surface that mirrors an environment of smooth coloured bands."""
    along = (hit.normals * hit.to_camera).sum(-1, keepdims=True)
    colors: np.ndarray = 0.5 + 0.45 * np.sin((2 * along * hit.normals - hit.to_camera) * [6.0, 5.0, 7.0])
    return colors


def spokes() -> Spheres:
    """Return a small ball with six rods, about a pixel and a half thick at 64 pixels."""
    rods = [axis * sign * reach for axis in np.eye(3) for sign in (-1, 1) for reach in np.linspace(0.3, 0.9, 31)]
    return np.array([np.zeros(3), *rods]), np.array([0.3, *[0.025] * len(rods)])


def make_scene(name: str, seed: int, size: int = 64) -> Scene:
    """Build one of SCENES: 20 training views, and 3 held out, all around; the seed draws exposures and wrong poses."""
    spheres, shade = SHAPES.get(name, BALL), SHADES.get(name, textured)
    cameras = [_camera(direction, size) for direction in _directions(23)]
    views = [_view(f"v_{i:02d}", camera, spheres, shade) for i, camera in enumerate(cameras)]
    held_out = views[3::8]
    train = [view for view in views if view not in held_out]
    change = CHANGES.get(name)
    if change is not None:
        train, held_out = change(train, held_out, np.random.default_rng(seed))
    return Scene(name, Path(name), "made", train, held_out, None, Similarity())


def make_start(name: str, seed: int, count: int = 500) -> StartingPoints:
    """Draw points near the surface: off by up to a tenth of the radius, in grey."""
    centers, radii = SHAPES.get(name, BALL)
    random = np.random.default_rng(seed)
    of = random.choice(len(radii), count, p=radii / radii.sum())
    normals = random.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    positions = centers[of] + normals * (radii[of] * random.uniform(1.0, 1.1, count))[:, None]
    return StartingPoints(positions, np.full((count, 3), 128, dtype=np.uint8), StartSource.CAPTURE, normals)


def surface_error(name: str, points: np.ndarray) -> float:
    """Return the mean distance of points [P,3] from the true surface, times 1000."""
    centers, radii = SHAPES.get(name, BALL)
    away = np.linalg.norm(points[:, None] - centers, axis=2) - radii
    return 1000 * float(np.abs(away).min(axis=1).mean())


def _dark(train: list[View], held_out: list[View], _: np.random.Generator) -> tuple[list[View], list[View]]:
    """Reduce the light to a fiftieth, which leaves twelve grey levels."""
    darker = [[replace(v, image=(v.image // 20).astype(np.uint8)) for v in views] for views in (train, held_out)]
    return darker[0], darker[1]


def _exposed(train: list[View], held_out: list[View], random: np.random.Generator) -> tuple[list[View], list[View]]:
    """Multiply every training view by its own factor of 0.6 to 1.6, clipped."""
    gains = random.uniform(0.6, 1.6, len(train))
    scaled = [(view.image * gain).clip(0, 255).astype(np.uint8) for view, gain in zip(train, gains, strict=True)]
    return [replace(view, image=image) for view, image in zip(train, scaled, strict=True)], held_out


def _misplaced(train: list[View], held_out: list[View], random: np.random.Generator) -> tuple[list[View], list[View]]:
    """Give one of the training views the pose of another."""
    wrong, other = random.choice(len(train), 2, replace=False)
    return [replace(v, camera=train[other].camera) if i == wrong else v for i, v in enumerate(train)], held_out


SHADES: dict[str, Callable[[Hit], np.ndarray]] = {
    "flash": flashed,
    "mirror": mirrored,
    "textureless": lambda hit: np.full(hit.points.shape, 0.5),
}
SHAPES: dict[str, Spheres] = {"thin": spokes()}
CHANGES: dict[str, Callable[..., tuple[list[View], list[View]]]] = {
    "dark": _dark,
    "exposure": _exposed,
    "wrong_poses": _misplaced,
}
SCENES = ("plain", "dark", "flash", "mirror", "textureless", "thin", "exposure", "wrong_poses")


def _directions(count: int) -> np.ndarray:
    i = np.arange(count) + 0.5
    z, turn = 1 - 2 * i / count, i * np.pi * (1 + 5**0.5)
    ring = np.sqrt(1 - z * z)
    return np.stack([ring * np.cos(turn), ring * np.sin(turn), z], axis=1)


def _camera(direction: np.ndarray, size: int) -> Camera:
    right = np.cross(-direction, [0.1, 0.2, 1.0])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(-direction, right), -direction])
    pose[:3, 3] = -pose[:3, :3] @ (direction * DISTANCE)
    return Camera(np.array([[1.2 * size, 0, size / 2], [0, 1.2 * size, size / 2], [0, 0, 1.0]]), pose, size, size)


def _view(name: str, camera: Camera, spheres: Spheres, shade: Callable[[Hit], np.ndarray]) -> View:
    fine = camera.resized(camera.width * SAMPLES, camera.height * SAMPLES)
    rows, columns = np.mgrid[: fine.height, : fine.width] + 0.5
    rays = np.stack([columns, rows, np.ones_like(rows)], -1).reshape(-1, 3) @ np.linalg.inv(fine.K).T
    rays = rays @ camera.cam_from_world[:3, :3]
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    nearest, normals = np.full(len(rays), np.inf), np.zeros_like(rays)
    for center, radius in zip(*spheres, strict=True):
        along = rays @ (center - camera.center)
        inside = radius**2 - ((center - camera.center) @ (center - camera.center) - along**2)
        depth = np.where(inside > 0, along - np.sqrt(np.maximum(inside, 0)), np.inf)
        closer = depth < nearest
        nearest[closer] = depth[closer]
        normals[closer] = (camera.center + rays[closer] * depth[closer][:, None] - center) / radius
    seen = np.isfinite(nearest)
    color = np.zeros_like(rays)
    color[seen] = shade(Hit(camera.center + rays[seen] * nearest[seen][:, None], normals[seen], -rays[seen]))
    blocks = (camera.height, SAMPLES, camera.width, SAMPLES)
    alpha = seen.reshape(blocks).mean(axis=(1, 3))
    mean = color.reshape(*blocks, 3).mean(axis=(1, 3)) / np.maximum(alpha, 1e-6)[..., None]
    return View(name, camera, _bytes(mean), _bytes(alpha))


def _bytes(image: np.ndarray) -> np.ndarray:
    return (image.clip(0, 1) * 255).round().astype(np.uint8)
