"""Tests of a flash's irradiance on a ball before a wall, against ray, ball and plane on paper, and in photographs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from mgsr.data.camera import Camera
from mgsr.data.images import srgb_to_linear
from mgsr.data.scene import Scene, Similarity
from mgsr.geometry.mesh import Mesh
from mgsr.shading.lighting import Lighting, add_irradiance
from tests.mesh.shapes import looking_at_origin
from tests.shading.test_shape_from_shading import flash, photographs, refine, rippled

RADIUS, BEFORE = 0.3, np.array([0.0, 0.0, 0.5])  # of the ball, and its centre before the wall z = 0
RIGHT, DOWN, LAMP, BESIDES = 0.4, -0.3, 3.0, 0.1


def ball_and_wall() -> Lighting:
    ball = trimesh.creation.icosphere(subdivisions=5, radius=RADIUS).apply_translation(BEFORE)
    side = np.linspace(-1, 1, 41)
    x, y = np.meshgrid(side, side)
    corner = (np.arange(40)[:, None] * 41 + np.arange(40)).ravel()
    faces = np.concatenate([corner[:, None] + [0, 1, 42], corner[:, None] + [0, 42, 41]])
    vertices = np.concatenate([ball.vertices, np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3)])
    faces = np.concatenate([ball.faces, faces + len(ball.vertices)])
    ambient = np.full(len(vertices), BESIDES)
    return Lighting(Mesh(vertices, faces), ambient, np.arange(len(vertices)), RIGHT, DOWN, LAMP)


def camera(side: int = 512) -> Camera:
    return looking_at_origin(np.array([0.5, -0.8, 2.6]), side=side)


def on_paper(view: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Return 255 light^(1/2.4) at the pixels' middles [H,W], and where ball or wall are [H,W]."""
    y, x = np.mgrid[: view.height, : view.width] + 0.5
    local = np.stack([x, y, np.ones_like(x)], axis=-1) @ np.linalg.inv(view.K).T
    rays = local @ view.cam_from_world[:3, :3]
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    to_ball = first_on_ball(view.center, rays)
    to_wall = -view.center[2] / rays[..., 2]
    on_ball = to_ball < to_wall
    points = view.center + np.where(on_ball, to_ball, to_wall)[..., None] * rays
    there = on_ball | ((np.abs(points[..., :2]) < 1).all(axis=-1) & (to_wall > 0))
    normals = np.where(on_ball[..., None], (points - BEFORE) / RADIUS, [0, 0, 1.0])
    right, down, _ = view.cam_from_world[:3, :3]
    way = view.center + RIGHT * right + DOWN * down - points
    far = np.linalg.norm(way, axis=-1)
    cosine = np.maximum((way * normals).sum(axis=-1) / far, 0)
    free = on_ball | ~np.isfinite(first_on_ball(points, way / far[..., None]))
    return 255 * (LAMP * cosine / far**2 * free + BESIDES) ** (1 / 2.4), there


def first_on_ball(origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Return how far rays go until they meet the ball; infinite where they do not."""
    way = origins - BEFORE
    along = (way * directions).sum(axis=-1)
    square = along**2 - (way**2).sum(axis=-1) + RADIUS**2
    near = -along - np.sqrt(np.maximum(square, 0))
    return np.where((square > 0) & (near > 0), near, np.inf)


def test_light_on_points_is_that_on_paper() -> None:
    """Check the light on points of the wall, some of it in the ball's shadow, against that on paper."""
    view, (x, y) = camera(), np.meshgrid(np.linspace(-0.9, 0.9, 37), np.linspace(-0.9, 0.9, 37))
    points = np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3)
    right, down, _ = view.cam_from_world[:3, :3]
    way = view.center + RIGHT * right + DOWN * down - points
    far = np.linalg.norm(way, axis=1)
    hidden = np.isfinite(first_on_ball(points, way / far[:, None]))
    expected = np.where(hidden, 0, LAMP * way[:, 2] / far**3 + BESIDES)
    found = ball_and_wall().falling_on(view, points, np.tile([0, 0, 1.0], (len(points), 1)))
    near = np.abs(found - expected) < 1e-5
    assert hidden.mean() > 0.03 and near.mean() > 0.98  # facets of the ball shade a little less than it


def test_light_and_shadow_are_those_on_paper() -> None:
    found, (expected, there) = ball_and_wall().seen_by(camera()), on_paper(camera())
    off = np.abs(found - expected)[there]
    # Outlines of ball and shadow fall within pixels, and facets are not quite the ball.
    assert np.median(off) < 0.5 and (off > 3).mean() < 0.02
    shadow = there & (np.abs(expected - 255 * BESIDES ** (1 / 2.4)) < 1e-6)
    assert shadow.sum() > 2000 and (np.abs(found - expected)[shadow] < 1).mean() > 0.93


def test_a_small_image_has_the_mean_light_of_its_pixels() -> None:
    large, small = (ball_and_wall().seen_by(camera(side)) / 255 for side in (512, 128))
    mean = ((large**2.4).reshape(128, 4, 128, 4).mean(axis=(1, 3))) ** (1 / 2.4)
    _, there = on_paper(camera(512))
    whole = there.reshape(128, 4, 128, 4).all(axis=(1, 3))
    assert np.abs(small - mean)[whole].max() < 0.01


def test_beside_the_surface_as_at_its_nearest_pixel() -> None:
    found, (_, there) = ball_and_wall().seen_by(camera()), on_paper(camera())
    assert there.mean() < 0.9
    row = np.flatnonzero(there.any(axis=1))[0]
    column = np.flatnonzero(there[row])[0]
    assert abs(int(found[0, column]) - int(found[row + 1, column])) <= 3


def test_who_sees_nothing_meets_full_light() -> None:
    behind = looking_at_origin(np.array([0, 0.2, 3.0]))
    turned = replace(behind, cam_from_world=np.diag([-1.0, 1, -1, 1]) @ behind.cam_from_world)
    assert (ball_and_wall().seen_by(turned) == 255).all()


def test_places_that_are_not_known_are_lit_as_others() -> None:
    whole = ball_and_wall()
    inside_out = replace(whole, mesh=Mesh(whole.mesh.vertices, whole.mesh.faces[:, ::-1]))
    dark = inside_out.seen_by(camera())
    assert np.percentile(dark, 99) == round(255 * BESIDES ** (1 / 2.4))
    # Every vertex of the ball as its topmost: one light for the ball.
    ball = np.linalg.norm(whole.mesh.vertices - BEFORE, axis=1) < RADIUS + 1e-6
    proxy_vertex = np.where(ball, np.argmax(np.where(ball, whole.mesh.vertices[:, 2], -1)), whole.proxy_vertex)
    found, plain = (each.seen_by(camera()) for each in (replace(whole, proxy_vertex=proxy_vertex), whole))
    pixels, _ = camera().project(BEFORE + np.array([[0, 0, RADIUS], [0.15, 0.1, 0.24]]))
    (x, y), (u, v) = np.floor(pixels).astype(int)
    assert abs(int(found[v, u]) - int(plain[y, x])) <= 1 < abs(int(plain[v, u]) - int(plain[y, x]))


def test_darkness_is_never_complete() -> None:
    dark = replace(ball_and_wall(), lamp=0.0, ambient=np.zeros(len(ball_and_wall().mesh.vertices)))
    assert (dark.seen_by(camera()) == round(255 * dark.options.dimmest ** (1 / 2.4))).all()


def test_the_light_goes_along_into_another_frame() -> None:
    to = Similarity(2.5, np.array([3.0, -1.0, 0.5]))
    moved = ball_and_wall().moved(to)
    same = moved.seen_by(to.camera_to_user(camera()))
    assert np.abs(same.astype(int) - ball_and_wall().seen_by(camera())).mean() < 0.02
    back = moved.moved(to.inverse)
    np.testing.assert_allclose(back.mesh.vertices, ball_and_wall().mesh.vertices, atol=1e-12)
    assert back.lamp == pytest.approx(LAMP) and back.right == pytest.approx(RIGHT)


@pytest.mark.slow
def test_what_photographs_tell_of_the_light_explains_them() -> None:
    """Check that photographs of two paints, divided by the light, are of two brightnesses again, highlights aside."""
    aside = (0.2, -0.3)
    (refined, estimate), views = refine(flash, aside), photographs(rippled(), flash, aside)
    assert estimate.model is not None
    lighting = estimate.model.lighting(refined)
    assert lighting is not None
    assert abs(lighting.right - aside[0]) < 0.03 and abs(lighting.down - aside[1]) < 0.03
    scene = Scene("ball", rippled, "", views[:30], views[30:], None, Similarity())  # type: ignore[arg-type]
    before, after = [], []
    for view in add_irradiance(scene, lighting).test:
        assert view.irradiance is not None and view.alpha is not None
        light = srgb_to_linear(view.image / 255.0).mean(axis=-1)
        usable = (view.alpha == 255) & (view.image.max(axis=-1) < 200)
        reddish = view.image[..., 0] > view.image[..., 2]
        for paint in (usable & reddish, usable & ~reddish):
            even = light[paint] / (view.irradiance[paint] / 255) ** 2.4
            after.append(np.std(even) / np.mean(even))
            before.append(np.std(light[paint]) / np.mean(light[paint]))
    assert np.mean(before) > 0.25 and np.mean(after) < 0.1


def test_a_scene_without_a_flash_stays() -> None:
    scene = Scene("ball", rippled, "", photographs(rippled(), flash)[:2], [], None, Similarity())  # type: ignore[arg-type]
    assert add_irradiance(scene, None) is scene
