"""A scene with a known answer: a textured ball of radius 0.5 at the origin, ray-cast in numpy."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from mgsr.data.camera import Camera
from mgsr.data.scene import Scene, Similarity, View
from mgsr.start.points import StartingPoints, StartSource

RADIUS = 0.5
DISTANCE = 2.5


def ball_scene(size: int = 48, train: int = 10, test: int = 2, masked: bool = True, gloss: float = 0.0) -> Scene:
    """Return views all around the ball, `size` pixels square; without masks on white.

    gloss: how bright the highlight of a flash on the camera is.
    """
    directions = _sphere(train + test)
    views = [_view(f"r_{i}", _camera(direction, size), masked, gloss) for i, direction in enumerate(directions)]
    step = (train + test) // test
    held_out = views[::step][:test]
    names = {view.name for view in held_out}
    kept = [view for view in views if view.name not in names]
    return Scene("ball", Path("ball"), "made", kept, held_out, None, Similarity())


def ball_points(count: int = 300, radius: float = RADIUS * 1.05) -> StartingPoints:
    """Return points on a slightly larger ball, in paler colours than the ball's."""
    normals = _sphere(count)
    colors = _bytes(0.25 + 0.5 * ball_color(normals * RADIUS))
    return StartingPoints(normals * radius, colors, StartSource.BALL, normals)


def ball_color(points: np.ndarray) -> np.ndarray:
    """Return the texture at points of the surface."""
    colors: np.ndarray = 0.5 + 0.4 * np.sin(points * [9.0, 7.0, 5.0] + [0.0, 1.0, 2.0])
    return colors


def _sphere(count: int) -> np.ndarray:
    """Return evenly spread directions."""
    i = np.arange(count) + 0.5
    z, turn = 1 - 2 * i / count, i * np.pi * (1 + 5**0.5)
    ring = np.sqrt(1 - z * z)
    return np.stack([ring * np.cos(turn), ring * np.sin(turn), z], axis=1)


def _camera(direction: np.ndarray, size: int) -> Camera:
    forward = -direction
    right = np.cross(forward, [0.1, 0.2, 1.0])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward])
    pose[:3, 3] = -pose[:3, :3] @ (direction * DISTANCE)
    K = np.array([[1.6 * size, 0, size / 2], [0, 1.6 * size, size / 2], [0, 0, 1.0]])
    return Camera(K, pose, size, size)


def surface_points(camera: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return where each pixel's ray first meets the ball [H,W,3], its unit direction [H,W,3], and whether it does."""
    rows, columns = np.mgrid[: camera.height, : camera.width] + 0.5
    local = np.stack([columns, rows, np.ones_like(rows)], axis=-1) @ np.linalg.inv(camera.K).T
    rays = local @ camera.cam_from_world[:3, :3]
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    along = -(rays @ camera.center)
    inside = RADIUS**2 - (camera.center @ camera.center - along**2)
    points = camera.center + rays * (along - np.sqrt(np.maximum(inside, 0)))[..., None]
    return points, rays, inside > 0


def _view(name: str, camera: Camera, masked: bool, gloss: float, samples: int = 3) -> View:
    """Render one view with samples x samples rays a pixel."""
    fine = camera.resized(camera.width * samples, camera.height * samples)
    points, rays, hit = surface_points(fine)
    blocks = (camera.height, samples, camera.width, samples)
    alpha = hit.reshape(blocks).mean(axis=(1, 3))
    towards = np.einsum("...i,...i", points, -rays) / RADIUS
    shade = ball_color(points) + gloss * np.exp(np.minimum(towards - 1, 0) * 20)[..., None]
    color = (shade * hit[..., None]).reshape(*blocks, 3).mean(axis=(1, 3))
    if not masked:
        return View(name, camera, _bytes(color + (1 - alpha[..., None])))
    return View(name, camera, _bytes(color / np.maximum(alpha, 1e-6)[..., None]), _bytes(alpha))


def _bytes(image: np.ndarray) -> np.ndarray:
    rounded: np.ndarray = (np.clip(image, 0, 1) * 255).round().astype(np.uint8)
    return rounded


def before(color: tuple[int, int, int], noise: float = 3.0, masked: bool = False, scene: Scene | None = None) -> Scene:
    """Photograph a masked scene, by default the ball, before a backdrop with noise, with or without its masks."""
    random = np.random.default_rng(0)
    scene = ball_scene(48, train=6) if scene is None else scene

    def placed(view: View) -> View:
        assert view.alpha is not None
        cover = view.alpha[..., None] / 255.0
        image = view.image * cover + np.array(color) * (1 - cover) + random.normal(0, noise, view.image.shape)
        return replace(view, image=image.round().clip(0, 255).astype(np.uint8), alpha=view.alpha if masked else None)

    return replace(scene, train=[placed(view) for view in scene.train])
