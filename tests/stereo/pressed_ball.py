"""A ball with a bowl pressed into a flat cap, which no silhouette shows, and photographs of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import trimesh

from mgsr.data.camera import Camera
from mgsr.data.scene import View
from mgsr.geometry.raycast import RayCaster, pixel_rays
from tests.mesh.shapes import looking_at_origin

CAP, DEPTH, WIDTH = 0.5, 0.08, 0.35  # of the bowl, in the unit of the ball's radius, which is 0.7


def hull() -> trimesh.Trimesh:
    """Return the ball with its flat cap."""
    mesh = trimesh.creation.icosphere(subdivisions=5, radius=0.7)
    vertices = mesh.vertices.copy()
    vertices[:, 2] = np.minimum(vertices[:, 2], CAP)
    return trimesh.Trimesh(vertices, mesh.faces, process=False)


def bowl_depth(places: np.ndarray) -> np.ndarray:
    """Return how far [P] the bowl lies under the cap at x and y."""
    depth: np.ndarray = DEPTH * np.clip(1 - (np.linalg.norm(places[:, :2], axis=1) / WIDTH) ** 2, 0, None)
    return depth


def pressed() -> trimesh.Trimesh:
    """Return the ball with the bowl."""
    mesh = hull()
    vertices = mesh.vertices.copy()
    flat = vertices[:, 2] == CAP
    vertices[flat, 2] -= bowl_depth(vertices[flat])
    return trimesh.Trimesh(vertices, mesh.faces, process=False)


def paint(places: np.ndarray, pattern: bool) -> np.ndarray:
    """Return the linear light of the paint: blotches of two colours, or one colour."""
    blend = 0.5 + 0.5 * np.sin(23 * places[..., 0] + 5) * np.sin(19 * places[..., 1]) * np.cos(21 * places[..., 2])
    blend = blend[..., None] if pattern else 0.5
    return blend * np.array([0.6, 0.4, 0.1]) + (1 - blend) * np.array([0.1, 0.3, 0.6])


def cameras_above(count: int, side: int) -> list[Camera]:
    """Return cameras that look at the bowl from up to 45 degrees beside its axis, spread evenly."""
    turns = np.arange(count) * np.pi * (3 - 5**0.5)
    tilts = np.radians(45) * np.sqrt((np.arange(count) + 0.5) / count)
    centers = 3 * np.stack([np.sin(tilts) * np.cos(turns), np.sin(tilts) * np.sin(turns), np.cos(tilts)], axis=1)
    return [looking_at_origin(center, side) for center in centers]


def photographs(pattern: bool, gloss: float, cameras: Sequence[Camera]) -> list[View]:
    """Photograph the pressed ball, lit by a white lamp that stands still; gloss: strength of its highlight."""
    mesh = pressed()
    caster = RayCaster(mesh.vertices, mesh.faces)
    return [_photograph(str(index), camera, caster, pattern, gloss) for index, camera in enumerate(cameras)]


def _photograph(name: str, camera: Camera, caster: RayCaster, pattern: bool, gloss: float) -> View:
    hits, rays, lamp = caster.cast(camera), pixel_rays(camera), np.array([0.4, 0.3, 0.866])
    places = camera.center + rays * hits.depth[..., None]
    towards = -rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    half = (towards + lamp) / np.linalg.norm(towards + lamp, axis=-1, keepdims=True)
    shine = gloss * np.clip((half * hits.normal).sum(-1), 0, 1)[..., None] ** 30
    shade = 0.5 + 0.4 * np.clip(hits.normal @ lamp, 0, 1)[..., None]
    light = np.clip(paint(places, pattern) * shade + shine, 0, 1)
    srgb = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    alpha = (hits.mask * 255).astype(np.uint8)
    return View(name, camera, np.round(255 * srgb * hits.mask[..., None]).astype(np.uint8), alpha)


def with_noise(view: View, seed: int) -> View:
    """Return the view as if the photograph showed a disc alone, which cuts the ball off, and noise around it."""
    y, x = np.mgrid[: view.camera.height, : view.camera.width]
    known = np.hypot(x - 0.4 * view.camera.width, y - 0.5 * view.camera.height) < 0.35 * view.camera.width
    noise = np.random.default_rng(seed).integers(0, 256, view.image.shape).astype(np.uint8)
    alpha = None if view.alpha is None else np.where(known, view.alpha, noise[..., 0])
    return replace(view, image=np.where(known[..., None], view.image, noise), alpha=alpha, valid_mask=known)
