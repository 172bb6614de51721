"""Carving by colour, on a ball with a bowl pressed into a flat cap, which no silhouette shows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from mgsr.data.scene import View
from mgsr.geometry.raycast import RayCaster, pixel_rays
from mgsr.start.photo_carving import carve_by_color
from tests.mesh.shapes import cameras_around

CAP, DEPTH, WIDTH = 0.5, 0.08, 0.35  # of the bowl, in the radius of the ball, which is 0.7


def hull() -> trimesh.Trimesh:
    mesh = trimesh.creation.icosphere(subdivisions=5, radius=0.7)
    vertices = mesh.vertices.copy()
    vertices[:, 2] = np.minimum(vertices[:, 2], CAP)
    return trimesh.Trimesh(vertices, mesh.faces, process=False)


def bowl_depth(places: np.ndarray) -> np.ndarray:
    """How far [P] the bowl lies under the cap at x and y."""
    return DEPTH * np.clip(1 - (np.linalg.norm(places[:, :2], axis=1) / WIDTH) ** 2, 0, None)


def pressed() -> trimesh.Trimesh:
    mesh = hull()
    vertices = mesh.vertices.copy()
    flat = vertices[:, 2] == CAP
    vertices[flat, 2] -= bowl_depth(vertices[flat])
    return trimesh.Trimesh(vertices, mesh.faces, process=False)


def paint(places: np.ndarray, pattern: bool) -> np.ndarray:
    """Linear light: blotches of two colours, or one colour."""
    blend = 0.5 + 0.5 * np.sin(23 * places[..., 0] + 5) * np.sin(19 * places[..., 1]) * np.cos(21 * places[..., 2])
    blend = blend[..., None] if pattern else 0.5
    return blend * np.array([0.6, 0.4, 0.1]) + (1 - blend) * np.array([0.1, 0.3, 0.6])


def photographs(pattern: bool, gloss: float) -> list[View]:
    """The pressed ball, lit by a white lamp that stands still; gloss: strength of its highlight."""
    mesh, views = pressed(), []
    caster, lamp = RayCaster(mesh.vertices, mesh.faces), np.array([0.4, 0.3, 0.866])
    for index, camera in enumerate(cameras_around(60, side=160)):
        hits, rays = caster.cast(camera), pixel_rays(camera)
        places = camera.center + rays * hits.depth[..., None]
        towards = -rays / np.linalg.norm(rays, axis=-1, keepdims=True)
        half = (towards + lamp) / np.linalg.norm(towards + lamp, axis=-1, keepdims=True)
        shine = gloss * np.clip((half * hits.normal).sum(-1), 0, 1)[..., None] ** 30
        shade = 0.5 + 0.4 * np.clip(hits.normal @ lamp, 0, 1)[..., None]
        light = np.clip(paint(places, pattern) * shade + shine, 0, 1)
        srgb = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
        alpha = (hits.mask * 255).astype(np.uint8)
        views.append(View(str(index), camera, np.round(255 * srgb * hits.mask[..., None]).astype(np.uint8), alpha))
    return views


@pytest.mark.parametrize("gloss", [0.0, 0.4])
def test_the_bowl_is_found_and_the_rest_stays(gloss: float) -> None:
    mesh = hull()
    carved = carve_by_color(mesh.vertices, mesh.faces, photographs(True, gloss))
    moved = np.linalg.norm(carved - mesh.vertices, axis=1)
    bowl, middle = bowl_depth(mesh.vertices), np.linalg.norm(mesh.vertices[:, :2], axis=1) < 0.2
    deep = middle & (mesh.vertices[:, 2] == CAP)
    pixel = 2.5 / 208  # on the cap
    assert np.abs(moved - bowl)[deep].mean() < 0.7 * pixel  # and it is 4.5 to 6.7 pixels deep there
    assert np.median(moved[mesh.vertices[:, 2] < CAP - 0.1]) < 0.02 * pixel
    assert (moved[mesh.vertices[:, 2] < CAP - 0.1] > pixel).mean() < 0.02


def test_one_colour_says_nothing() -> None:
    mesh = hull()
    carved = carve_by_color(mesh.vertices, mesh.faces, photographs(False, 0.0))
    assert np.linalg.norm(carved - mesh.vertices, axis=1).max() < 1e-6


def with_noise(view: View, seed: int) -> View:
    """The view as if the photograph showed a disc alone, which cuts the ball off, and noise around it."""
    y, x = np.mgrid[: view.camera.height, : view.camera.width]
    known = np.hypot(x - 0.4 * view.camera.width, y - 0.5 * view.camera.height) < 0.35 * view.camera.width
    noise = np.random.default_rng(seed).integers(0, 256, view.image.shape).astype(np.uint8)
    alpha = None if view.alpha is None else np.where(known, view.alpha, noise[..., 0])
    return replace(view, image=np.where(known[..., None], view.image, noise), alpha=alpha, known=known)


def test_noise_at_unknown_pixels_changes_nothing() -> None:
    """The bowl is found from what is known, and to the byte the same whatever stands at other pixels."""
    mesh, views = hull(), [view for view in photographs(True, 0.0) if view.camera.center[2] > 0.3]
    first, second = (
        carve_by_color(mesh.vertices, mesh.faces, [with_noise(view, seed) for view in views]) for seed in (1, 2)
    )
    np.testing.assert_array_equal(first, second)
    deep = (np.linalg.norm(mesh.vertices[:, :2], axis=1) < 0.2) & (mesh.vertices[:, 2] == CAP)
    moved = np.linalg.norm(first - mesh.vertices, axis=1)
    assert np.abs(moved - bowl_depth(mesh.vertices))[deep].mean() < 2.5 / 208
