"""Shading by a flash and by an environment map, on a ball with ripples that the starting mesh lacks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from mgsr.config.expert import ShadingPass
from mgsr.data.camera import Camera
from mgsr.data.scene import View
from mgsr.geometry.mesh import Mesh
from mgsr.geometry.raycast import pixel_rays
from mgsr.shading.environment_fit import fit_environment_map
from mgsr.shading.environment_normals import normals_from_environment
from mgsr.shading.light_estimate import LightEstimate, estimate_light
from mgsr.shading.light_kind import LightKind
from mgsr.shading.light_models import EnvironmentLight
from mgsr.shading.observations import observe_photographs
from mgsr.shading.photo_set import PhotoSet
from mgsr.shading.shape_from_shading import shape_from_shading
from tests.mesh.shapes import as_mesh, ball, cameras_around, silhouettes_of

RADIUS = 0.7
SIDE = 128
FINE = ShadingPass(edge=1.0, rounds=3, reach=20.0)
LAMPS = np.array([[0.6, 0.2, 0.77], [-0.7, 0.5, -0.5], [0.1, -0.95, 0.3]])

Shade = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]  # paint, normal, offset to the eye -> linear light


def rippled() -> trimesh.Trimesh:
    mesh = ball(RADIUS)
    x, y, z = mesh.vertices.T / RADIUS
    ripples = 0.009 * np.sin(14 * x) * np.sin(14 * y) * np.cos(14 * z)
    return trimesh.Trimesh(mesh.vertices * (1 + ripples)[:, None], mesh.faces, process=False)


def grooved() -> trimesh.Trimesh:
    """Build a ball with sharp creases, in faces that are smaller than pixels."""
    mesh = trimesh.creation.icosphere(subdivisions=6, radius=RADIUS)
    grooves = 0.02 * np.abs(np.sin(10 * mesh.vertices[:, 2] / RADIUS))
    return trimesh.Trimesh(mesh.vertices * (1 + grooves)[:, None], mesh.faces, process=False)


def flash(paint: np.ndarray, normal: np.ndarray, offset: np.ndarray) -> np.ndarray:
    """Shade a surface by a lamp on the camera, with a highlight."""
    distance = np.maximum(np.linalg.norm(offset, axis=-1), 1e-9)
    cosine = np.clip((normal * offset).sum(-1) / distance, 0, 1)
    colors: np.ndarray = (0.05 + 6 / distance**2 * cosine)[..., None] * paint + 0.5 * (cosine**60)[..., None]
    return colors


def matte(paint: np.ndarray, normal: np.ndarray, offset: np.ndarray) -> np.ndarray:
    """Shade a matte surface by a lamp that stands still."""
    colors: np.ndarray = (0.05 + np.clip(normal @ np.array([0.3, 0.5, 0.81]), 0, 1))[..., None] * paint
    return colors


def glossy(paint: np.ndarray, normal: np.ndarray, offset: np.ndarray) -> np.ndarray:
    """Shade a surface as `matte` does, on varnish that mirrors three wide lamps."""
    eye = offset / np.maximum(np.linalg.norm(offset, axis=-1, keepdims=True), 1e-9)
    mirrored = 2 * (eye * normal).sum(-1, keepdims=True) * normal - eye
    colors: np.ndarray = 0.5 * matte(paint, normal, offset) + lamps(mirrored)[..., None]
    return colors


def varnished(paint: np.ndarray, normal: np.ndarray, offset: np.ndarray) -> np.ndarray:
    """Shade real varnish: it mirrors more of the lamps the more it is tilted.

    This is Schlick's form of Fresnel's law, index 1.5.
    """
    eye = offset / np.maximum(np.linalg.norm(offset, axis=-1, keepdims=True), 1e-9)
    cosine = np.clip((eye * normal).sum(-1, keepdims=True), 0, 1)
    mirrored = 2 * cosine * normal - eye
    more = 1 + 24 * (1 - cosine) ** 5
    colors: np.ndarray = 0.5 * matte(paint, normal, offset) + more * lamps(mirrored)[..., None]
    return colors


def lamps(directions: np.ndarray) -> np.ndarray:
    """Return the environment's light [...] in directions [...,3]."""
    light: np.ndarray = 0.35 * np.exp(6 * (directions @ LAMPS.T - 1)).sum(-1)
    return light


def photographs(
    mesh: trimesh.Trimesh, shade: Shade, aside: tuple[float, float] = (0, 0), side: int = SIDE, rays: int = 1
) -> list[View]:
    """Photograph a mesh in two paints by cameras around, in sRGB of 8 bits.

    aside: how far to the right of the lens and below it the eye is put, as a lamp may be; rays: along a pixel's side,
    whose mean it shows.
    """
    normals, views = Mesh(mesh.vertices, mesh.faces).normals, []
    caster = as_mesh(mesh).caster
    for index, camera in enumerate(cameras_around(40, side=side)):
        y, x = (np.mgrid[: side * rays, : side * rays] + 0.5) / rays
        hits = caster.cast_pixels(camera, np.stack([x, y], axis=-1))
        corners = mesh.faces[np.where(hits.mask, hits.face, 0)]
        normal = (normals[corners] * hits.barycentric[..., None]).sum(2)
        offsets = -pixel_rays(finer(camera, rays)) * hits.depth[..., None]
        paint = np.where(np.sin(9 * (camera.center - offsets)[..., :1]) > 0, [0.6, 0.4, 0.2], [0.2, 0.4, 0.5])
        eye = offsets + np.array(aside) @ camera.cam_from_world[:2, :3]
        light = np.clip(shade(paint, normal, eye), 0, 1) * hits.mask[..., None]
        light, alpha = (_mean(image, rays) for image in (light, hits.mask[..., None]))
        light = light / np.maximum(alpha, 1e-6)
        srgb = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
        image = np.round(255 * srgb).astype(np.uint8)
        views.append(View(str(index), camera, image, np.round(255 * alpha[..., 0]).astype(np.uint8)))
    return views


def finer(camera: Camera, rays: int) -> Camera:
    """Return the same camera with `rays` pixels along each pixel's side."""
    return Camera(np.diag([rays, rays, 1]) @ camera.K, camera.cam_from_world, rays * camera.width, rays * camera.height)


def _mean(image: np.ndarray, rays: int) -> np.ndarray:
    rows, columns, channels = image.shape
    return np.asarray(image.reshape(rows // rays, rays, columns // rays, rays, channels).mean(axis=(1, 3)))


def refine(
    shade: Shade,
    aside: tuple[float, float] = (0, 0),
    start: trimesh.Trimesh | None = None,
    work: ShadingPass = FINE,
) -> tuple[Mesh, LightEstimate]:
    """Refine the start, or else the smooth ball, by photographs of the rippled one."""
    return refined_by(photographs(rippled(), shade, aside), rippled(), start or ball(RADIUS), work)


def refined_by(
    views: list[View], truth: trimesh.Trimesh, start: trimesh.Trimesh, work: ShadingPass
) -> tuple[Mesh, LightEstimate]:
    """Refine the start by photographs of the truth, and its silhouettes."""
    photos = PhotoSet(views, silhouettes_of(truth, [view.camera for view in views]))
    light = estimate_light(as_mesh(start), photos, 0.85, LightEstimate())
    return shape_from_shading(as_mesh(start), photos, light, {kind: (work,) for kind in LightKind}), light


def tilt_error(vertices: np.ndarray, truth: trimesh.Trimesh) -> float:
    """Return the mean angle in degrees between the vertex normals of both."""
    found, true = (Mesh(places, truth.faces).normals for places in (vertices, truth.vertices))
    return float(np.degrees(np.arccos(np.clip((found * true).sum(1), -1, 1))).mean())


@pytest.mark.parametrize(
    ("shade", "aside", "light"),
    [
        pytest.param(flash, (0, 0), LightKind.FLASH, marks=pytest.mark.slow),
        (flash, (0.2, -0.3), LightKind.FLASH),
        (glossy, (0, 0), LightKind.ENVIRONMENT),
    ],
)
def test_ripples_come_out(shade: Shade, aside: tuple[float, float], light: LightKind) -> None:
    truth, smooth = rippled(), ball(RADIUS)
    refined, found = refine(shade, aside)
    assert found.kind is light
    assert tilt_error(smooth.vertices, truth) > 2.5
    assert tilt_error(refined.vertices, truth) < 0.75 * tilt_error(smooth.vertices, truth)
    radii = [np.linalg.norm(places, axis=1) for places in (truth.vertices, smooth.vertices, refined.vertices)]
    before, after = (np.abs(each - radii[0]).mean() for each in radii[1:])
    assert after < 0.9 * before


@pytest.mark.slow
def test_the_truth_stays_where_it_is_also_on_a_coarse_mesh() -> None:
    truth = rippled()
    refined, _ = refine(glossy, start=truth, work=ShadingPass(edge=6.0, rounds=4, reach=60.0))
    outwards = truth.vertices / np.linalg.norm(truth.vertices, axis=1, keepdims=True)
    assert abs(((refined.vertices - truth.vertices) * outwards).sum(1).mean()) < 0.0003


@pytest.mark.slow
def test_the_truth_stays_where_it_is_though_tilted_varnish_mirrors_more() -> None:
    truth = rippled()
    refined, light = refine(varnished, start=truth, work=ShadingPass(edge=4.0, rounds=2, reach=240.0))
    assert light.kind is LightKind.ENVIRONMENT
    assert np.linalg.norm(refined.vertices - truth.vertices, axis=1).mean() < 0.005


@pytest.mark.slow
def test_creases_stay_as_deep_as_they_are_though_pixels_flatten_them() -> None:
    truth = grooved()
    work = ShadingPass(edge=1.0, rounds=4, reach=20.0)
    refined, light = refined_by(photographs(truth, flash, rays=4), truth, truth, work)
    assert light.kind is LightKind.FLASH
    assert tilt_error(refined.vertices, truth) < 0.5


def test_matte_paint_under_a_lamp_that_stands_still_changes_nothing() -> None:
    refined, light = refine(matte)
    assert light.kind is LightKind.UNKNOWN
    np.testing.assert_array_equal(refined.vertices, ball(RADIUS).vertices)


def test_the_estimates_map_is_the_map_that_its_mesh_mirrors() -> None:
    mesh, photos = as_mesh(ball(RADIUS)), PhotoSet(photographs(ball(RADIUS), glossy))
    model = estimate_light(mesh, photos, 0.85, LightEstimate()).model
    assert isinstance(model, EnvironmentLight)
    anew = EnvironmentLight(photos.observer(photos.pixel_on(mesh)))
    np.testing.assert_array_equal(model.environment(mesh).light, anew.environment(mesh).light)


def test_the_map_is_the_environment_up_to_a_constant() -> None:
    mesh = ball(RADIUS)
    normals = as_mesh(mesh).double_normals
    seen = PhotoSet(photographs(mesh, glossy)).photographs
    observations = observe_photographs(as_mesh(mesh), seen, gap=0.01)
    found = fit_environment_map(observations, normals)
    directions = np.random.default_rng(0).normal(size=(2000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    x, y, z = ((directions.T + 1) * 32).astype(int)
    difference = found.table(64)[x, y, z] - lamps(directions)
    assert np.std(difference) < 0.15 * np.std(lamps(directions))
    assert found.ratio < 0.5


def test_tilted_normals_are_turned_back() -> None:
    mesh = ball(RADIUS)
    true = as_mesh(mesh).double_normals
    seen = PhotoSet(photographs(mesh, glossy)).photographs
    observations = observe_photographs(as_mesh(mesh), seen, gap=0.01)
    wave = np.sin(8 * mesh.vertices[:, 2] / RADIUS)  # to and fro, so that the map itself stays where it is
    tilted = true + 0.15 * wave[:, None] * [1.0, 0.0, 0.0]
    tilted /= np.linalg.norm(tilted, axis=1, keepdims=True)
    still, laplacian = np.zeros(len(true)), as_mesh(mesh).laplacian
    explained = normals_from_environment(observations, tilted, laplacian, reach=2.0, still=still)
    errors = [np.degrees(np.arccos(np.clip((n * true).sum(1), -1, 1))) for n in (tilted, explained.normals)]
    assert errors[1].mean() < 0.6 * errors[0].mean()
    kept = normals_from_environment(observations, tilted, laplacian, reach=2.0, still=1 - still)
    np.testing.assert_allclose(kept.normals, tilted, atol=1e-6)


@pytest.mark.slow
def test_true_normals_stay_within_a_fraction_of_the_fine_grid() -> None:
    """Check the error on the true ball: the coarse grid alone, with a parabola between its steps, errs by 0.11."""
    mesh = as_mesh(ball(RADIUS))
    true = mesh.double_normals
    seen = PhotoSet(photographs(ball(RADIUS), glossy)).photographs
    observations = observe_photographs(mesh, seen, gap=0.01)
    still = np.zeros(len(true))
    found = normals_from_environment(observations, true, mesh.laplacian, reach=2.0, still=still)
    errors = np.degrees(np.arccos(np.clip((found.normals * true).sum(1), -1, 1)))
    assert np.average(errors, weights=found.confidence) < 0.075


@pytest.mark.slow
def test_what_no_tilt_explains_is_not_trusted() -> None:
    mesh = ball(RADIUS)
    true = as_mesh(mesh).double_normals
    observations = observe_photographs(as_mesh(mesh), PhotoSet(photographs(mesh, glossy)).photographs, gap=0.01)
    odd = mesh.vertices[:, 0] > 0
    noise = np.random.default_rng(0).normal(scale=0.2, size=observations.brightness.shape)
    spoilt = replace(observations, brightness=observations.brightness + odd[:, None] * noise.astype(np.float32))
    laplacian, still = as_mesh(mesh).laplacian, np.zeros(len(true))
    confidence = normals_from_environment(spoilt, true, laplacian, reach=2.0, still=still).confidence
    assert confidence[~odd].mean() > 2 * confidence[odd].mean() > 0
