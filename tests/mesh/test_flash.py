"""Shading by a flash, on a ball with ripples that the starting mesh lacks."""

from __future__ import annotations

import numpy as np
import trimesh

from mgsr.data.scene import View
from mgsr.geometry.raycast import RayCaster, pixel_rays
from mgsr.geometry.triangles import vertex_normals
from mgsr.mesh.flash import refine_by_flash
from tests.mesh.shapes import ball, cameras_around

RADIUS = 0.7


def rippled() -> trimesh.Trimesh:
    mesh = ball(RADIUS)
    x, y, z = mesh.vertices.T / RADIUS
    ripples = 0.009 * np.sin(14 * x) * np.sin(14 * y) * np.cos(14 * z)
    return trimesh.Trimesh(mesh.vertices * (1 + ripples)[:, None], mesh.faces, process=False)


def photographs(mesh: trimesh.Trimesh, flash: bool) -> list[View]:
    """Two paints under a lamp on the camera, with a highlight, or under one that stands still."""
    normals, views = vertex_normals(mesh.vertices, mesh.faces), []
    caster = RayCaster(mesh.vertices, mesh.faces)
    for index, camera in enumerate(cameras_around(40, side=128)):
        y, x = np.mgrid[:128, :128] + 0.5
        hits = caster.cast_pixels(camera, np.stack([x, y], axis=-1))
        corners = mesh.faces[np.where(hits.mask, hits.face, 0)]
        normal = (normals[corners] * hits.barycentric[..., None]).sum(2)
        offsets = -pixel_rays(camera) * hits.depth[..., None]
        distance = np.linalg.norm(offsets, axis=-1)
        lamp = offsets / np.maximum(distance, 1e-9)[..., None] if flash else np.array([0.3, 0.5, 0.81])
        falloff = 6.0 / np.maximum(distance, 1e-9) ** 2 if flash else 1.0
        cosine = np.clip((normal * lamp).sum(-1), 0, 1)
        paint = np.where(np.sin(9 * (camera.center - offsets)[..., :1]) > 0, [0.6, 0.4, 0.2], [0.2, 0.4, 0.5])
        light = (0.05 + falloff * cosine)[..., None] * paint + (0.5 * cosine**60 if flash else 0 * cosine)[..., None]
        light = np.clip(light, 0, 1) * hits.mask[..., None]
        srgb = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
        image, alpha = np.round(255 * srgb).astype(np.uint8), (hits.mask * 255).astype(np.uint8)
        views.append(View(str(index), camera, image, alpha))
    return views


def tilt_error(vertices: np.ndarray, truth: trimesh.Trimesh) -> float:
    """Mean angle in degrees between the vertex normals of both."""
    found, true = (vertex_normals(places, truth.faces) for places in (vertices, truth.vertices))
    return float(np.degrees(np.arccos(np.clip((found * true).sum(1), -1, 1))).mean())


def test_ripples_come_out_under_a_flash() -> None:
    truth, smooth = rippled(), ball(RADIUS)
    refined = refine_by_flash(smooth.vertices, smooth.faces, photographs(truth, flash=True), max_ratio=0.8)
    assert tilt_error(smooth.vertices, truth) > 2.5
    assert tilt_error(refined, truth) < 0.6 * tilt_error(smooth.vertices, truth)
    radii = [np.linalg.norm(places, axis=1) for places in (truth.vertices, smooth.vertices, refined)]
    before, after = (np.abs(found - radii[0]).mean() for found in radii[1:])
    assert after < 0.8 * before


def test_a_lamp_that_stands_still_changes_nothing() -> None:
    mesh = ball(RADIUS)
    refined = refine_by_flash(mesh.vertices, mesh.faces, photographs(rippled(), flash=False), max_ratio=0.8)
    np.testing.assert_array_equal(refined, mesh.vertices)
