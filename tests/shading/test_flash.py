"""A flash beside the lens: readings written out by Lambert's law, from which normals and lamp must come back."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from mgsr.geometry.mesh import Mesh
from mgsr.shading.ambient_occlusion import AmbientOcclusion
from mgsr.shading.flash import Flash, normals_from_flash
from mgsr.shading.flash_fit import fit_flash
from mgsr.shading.observations import Observations, observe_photographs
from mgsr.shading.target_normals import TargetNormals
from tests.mesh.shapes import as_mesh, cameras_around, joined, looking_at_origin
from tests.shading.painted import as_photograph

BALL = trimesh.creation.icosphere(subdivisions=4, radius=0.7)
POINTS = np.asarray(BALL.vertices)
NORMALS = POINTS / 0.7
CAMERAS = cameras_around(40)
LIGHT = Flash(right=0.15, down=-0.25, ambient=0.03, bounced=0.1)


def occlusion() -> AmbientOcclusion:
    """Return ambient occlusion and interreflection as if the ball had some: both change along it."""
    x, y, z = NORMALS.T
    interreflection = 0.1 * (1 + np.sin(4 * y))[:, None] * (1 + 0.5 * np.cos(np.arange(len(CAMERAS))))
    return AmbientOcclusion(Mesh(POINTS, np.asarray(BALL.faces)), 0.7 + 0.3 * np.sin(5 * x) * z, interreflection)


def observations(light: Flash, gloss: float = 0.0) -> Observations:
    """Compute each photograph's brightness at each of the ball's points, one by one."""
    seen, columns = occlusion(), []
    for index, camera in enumerate(CAMERAS):
        right, down, _ = camera.cam_from_world[:3, :3]
        lamp = camera.center + light.right * right + light.down * down
        eye, lit = camera.center - POINTS, lamp - POINTS
        distance, away = np.linalg.norm(eye, axis=1), np.linalg.norm(lit, axis=1)
        cosine = (NORMALS * eye).sum(1) / distance
        shade = np.clip((NORMALS * lit).sum(1) / away, 0, 1) / away**2
        paint = 0.5 + 0.2 * np.sin(7 * POINTS[:, 2])
        brightness = paint * (
            shade + light.ambient * seen.sky_visibility + light.bounced * seen.interreflection[:, index]
        )
        brightness += gloss * np.maximum(cosine, 0) ** 80
        weights = np.where(cosine > 0.25, cosine, 0)
        columns.append((eye / distance[:, None], distance, brightness, weights, np.full(len(POINTS), index)))
    *parts, numbers = (np.stack(part, axis=1) for part in zip(*columns, strict=True))
    view_directions, distances, brightness, weights = (part.astype(np.float32) for part in parts)
    return Observations(view_directions, distances, brightness, weights, numbers)


def tilted(degrees: float) -> np.ndarray:
    turned = NORMALS + np.tan(np.radians(degrees)) * np.sin(9 * POINTS[:, [1, 2, 0]])
    return np.asarray(turned / np.linalg.norm(turned, axis=1, keepdims=True))


def explain(seen: Observations, light: Flash) -> TargetNormals:
    return normals_from_flash(seen, POINTS, tilted(8), light, CAMERAS, occlusion())


def off(normals: np.ndarray) -> np.ndarray:
    """Return the degrees from the true normals, [P]."""
    return np.asarray(np.degrees(np.arccos(np.clip((normals * NORMALS).sum(1), -1, 1))))


@pytest.mark.parametrize("gloss", [0.0, 0.2])
def test_normals_come_back(gloss: float) -> None:
    seen = observations(LIGHT, gloss)
    assert off(tilted(8)).mean() > 5
    assert off(explain(seen, LIGHT).normals).mean() < 0.8
    assert off(explain(seen, Flash()).normals).mean() > 3


@pytest.mark.parametrize("light", [Flash(), LIGHT])
@pytest.mark.parametrize(("noise", "aside", "ambient"), [(0.0, 0.005, 0.002), (0.08, 0.03, 0.015)])
def test_the_lamp_is_found(light: Flash, noise: float, aside: float, ambient: float) -> None:
    """Check that the lamp is found; normals that are off by 5 degrees each put it off by less than one."""
    rough = NORMALS + np.random.default_rng(1).normal(scale=noise, size=NORMALS.shape)
    rough /= np.linalg.norm(rough, axis=1, keepdims=True)
    assert off(rough).mean() > 60 * noise
    found = fit_flash(observations(light, 0.1), POINTS, rough, CAMERAS, occlusion(), Flash())
    assert abs(found.right - light.right) < aside and abs(found.down - light.down) < aside
    assert abs(found.ambient - light.ambient) < ambient
    assert abs(found.bounced - light.bounced) < 0.02


def test_lamps_are_where_the_image_has_its_right_and_its_lower_side() -> None:
    camera = looking_at_origin(np.array([0.0, -3.0, 0.5]))
    pixels, _ = camera.project(np.zeros((1, 3)))
    shifts = [Flash(right=0.1), Flash(down=0.1)]
    lamps = [flash.lamps([camera])[0] - camera.center for flash in shifts]
    moved = [camera.project(lamp[None])[0] - pixels for lamp in lamps]
    assert moved[0][0, 0] > 3 and abs(moved[0][0, 1]) < 1e-6
    assert moved[1][0, 1] > 3 and abs(moved[1][0, 0]) < 1e-6


def test_nothing_seen_leaves_the_light_as_it_was() -> None:
    blind = observations(LIGHT)
    blind = Observations(blind.view_directions, blind.distances, blind.brightness, 0 * blind.weights, blind.photographs)
    assert fit_flash(blind, POINTS, NORMALS, CAMERAS, occlusion(), LIGHT) == LIGHT
    assert not explain(blind, LIGHT).confidence.any()


def test_points_whose_readings_disagree_are_not_trusted() -> None:
    seen = observations(LIGHT)
    brightness, odd = seen.brightness.copy(), np.arange(len(POINTS)) % 2 == 0
    brightness[odd] *= np.random.default_rng(0).uniform(0.5, 1.5, brightness[odd].shape)
    confidence = explain(
        Observations(seen.view_directions, seen.distances, brightness, seen.weights, seen.photographs), LIGHT
    ).confidence
    assert confidence[odd].mean() < 0.2
    assert confidence[~odd].mean() > 0.9


def test_a_vertex_in_the_shadow_of_the_lamp_is_not_read() -> None:
    """Check that the vertices of a plate from which a screen keeps the lamp are not read."""
    camera = looking_at_origin(np.array([0.001, 0.0, 4.0]))
    plate = trimesh.creation.box((1.0, 1.0, 0.01)).subdivide().subdivide().subdivide()
    screen = trimesh.creation.box((0.01, 1.0, 0.3))
    screen.apply_translation((0.0, 0.0, 0.155))
    both = joined(plate, screen)
    even = as_photograph(camera, np.full((96, 96), 0.5))
    lamp = np.array([[2.0, 0.0, 2.0]])  # from the right, at 45 degrees
    read = [observe_photographs(as_mesh(both), [even], 0.005, lamps=lamps) for lamps in (None, lamp)]
    top = np.flatnonzero((both.vertices[:, 2] > 0.004) & (both.vertices[:, 2] < 0.006))
    x = both.vertices[top, 0]
    shaded = (x < -0.05) & (x > -0.2)
    beyond = (x < -0.4) | (x > 0.05)
    inner = np.abs(both.vertices[top, 1]) < 0.45
    assert (read[0].weights[top[shaded & inner]] > 0).all() and shaded.any()
    assert not read[1].weights[top[shaded & inner]].any()
    assert (read[1].weights[top[beyond & inner]] > 0).all()
