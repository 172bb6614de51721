"""Pictures of a textured mesh in an environment, held to what balls look like by calculus."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from mgsr.config import MeshConfig, OutputConfig
from mgsr.data.images import linear_to_srgb
from mgsr.mesh.relighting import SAMPLES, SeenSurface, irradiance, look_at_textured, studio_light
from mgsr.mesh.surface import ReconstructedMesh, TexturedMesh
from mgsr.mesh.texture import texture_levels
from mgsr.shading.environment_fit import cell_directions
from mgsr.shading.material import Material
from tests.mesh.shapes import cameras_around, looking_at_origin, position_color, views_of

RADIUS = 0.7
EYE = np.array([0.0, -3.0, 0.0])  # x is on the right, z up
UP, FRONT = np.array([0.0, 0, 1]), np.array([0.0, -1, 0])


@pytest.fixture(scope="module")
def ball() -> TexturedMesh:
    """Build a ball with the colours of its places."""
    shape = trimesh.creation.icosphere(4, RADIUS)
    views = views_of(shape, cameras_around(16))
    return texture_levels(_full(shape), views, 0.02, OutputConfig(texture=256), MeshConfig(), shaded=False)[0]


def _full(shape: trimesh.Trimesh) -> ReconstructedMesh:
    vertices = np.asarray(shape.vertices, np.float64)
    return ReconstructedMesh(vertices, np.asarray(shape.faces, np.int64), np.full(vertices.shape, 0.5, np.float32))


def seen(
    mesh: TexturedMesh, white: bool = False, roughness: float = 1.0, metallic: float = 0.0
) -> tuple[SeenSurface, np.ndarray]:
    """Return what a camera at EYE sees of a ball, and the outward normal [P,3] at each hit, by geometry."""
    camera = looking_at_origin(EYE, 64)
    material = Material(roughness, None if roughness == 1 else (roughness, roughness), metallic)
    shown = look_at_textured(replace(mesh, material=material).with_normals(mesh.normals), camera)
    rows, columns = (np.argwhere(shown.hit) + 0.5).T / SAMPLES
    rays = np.stack([(columns - camera.K[0, 2]) / camera.K[0, 0], (rows - camera.K[1, 2]) / camera.K[1, 1]], axis=1)
    rays = np.concatenate([rays, np.ones((len(rays), 1))], axis=1) @ camera.cam_from_world[:3, :3]
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    middle = rays @ EYE
    depth = -middle - np.sqrt(np.maximum(middle**2 - EYE @ EYE + RADIUS**2, 0))
    normals = (EYE + depth[:, None] * rays) / RADIUS
    return (replace(shown, albedo=np.ones_like(shown.albedo)) if white else shown), normals


def inside(shown: SeenSurface, values: np.ndarray) -> np.ndarray:
    """Return values [H,W,...] of a picture where all rays of a pixel hit."""
    rows, columns = shown.hit.shape
    whole = shown.hit.reshape(rows // SAMPLES, SAMPLES, columns // SAMPLES, SAMPLES).all(axis=(1, 3))
    return np.asarray(values[whole])


def lamp(towards: np.ndarray, height: int = 48) -> np.ndarray:
    """Return a white lamp of 6 degrees in a black environment."""
    lit = cell_directions(height) @ towards > np.cos(np.radians(6))
    return np.repeat(lit[..., None], 3, axis=2).astype(np.float32)


def test_maps_are_read_where_the_rays_hit(ball: TexturedMesh) -> None:
    shown, normals = seen(ball)
    frontal = (normals @ -FRONT) < -0.5
    places = RADIUS * normals[frontal]
    error = np.abs(linear_to_srgb(shown.albedo[frontal]) - position_color(places))
    assert frontal.sum() > 500 and error.mean() < 0.01 and error.max() < 0.06
    assert (shown.normals * normals).sum(axis=1)[frontal].min() > np.cos(np.radians(2))
    assert shown.occlusion.min() > 0.99


@pytest.mark.parametrize("metallic", [0.0, 1.0])
def test_a_white_ball_in_a_white_room_is_white(ball: TexturedMesh, metallic: float) -> None:
    """Check that no light is lost: a metal mirrors all of it, a dielectric scatters what it does not mirror."""
    shown, _ = seen(ball, white=True, roughness=0.2, metallic=metallic)
    picture = inside(shown, shown.lit(np.ones((32, 64, 3), np.float32)))
    assert (picture[..., 3] == 1).all()
    assert picture[..., :3].mean() == pytest.approx(1, abs=0.02)


def test_half_a_sky_lights_a_matte_ball_by_the_cosine_law() -> None:
    directions = cell_directions(32)
    sky = np.repeat((directions[..., 2:] > 0).astype(np.float32), 3, axis=2)
    normals = np.random.default_rng(0).normal(size=(500, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    shares = irradiance(sky, normals)
    # Degree 2 leaves out what follows; for a half sky that is nothing but odd degrees from 3 on, which cosines ignore.
    np.testing.assert_allclose(shares, np.repeat((1 + normals[:, 2:]) / 2, 3, axis=1), atol=0.03)


@pytest.mark.parametrize("towards", [(0.6, -0.8, 0.0), (0.0, -0.6, 0.8), (-0.48, -0.8, 0.36)])
def test_a_metal_ball_mirrors_a_lamp_where_geometry_has_it(ball: TexturedMesh, towards: tuple[float, ...]) -> None:
    shown, normals = seen(ball, white=True, roughness=0.25, metallic=1.0)
    light = np.asarray(towards)
    gloss = shown.lit(lamp(light))
    at = np.unravel_index(gloss[..., 0].argmax(), gloss.shape[:2])
    eye = EYE - RADIUS * normals
    half = eye / np.linalg.norm(eye, axis=1, keepdims=True) + light
    best = ((half / np.linalg.norm(half, axis=1, keepdims=True)) * normals).sum(axis=1).argmax()
    row, column = np.argwhere(shown.hit)[best] / SAMPLES
    assert abs(at[0] - row) < 2 and abs(at[1] - column) < 2


def test_a_mesh_seen_from_behind_is_lit_there(ball: TexturedMesh) -> None:
    """Check the inside of a half ball: its normals face the camera."""
    kept = ball.vertices[ball.faces].mean(axis=1)[:, 1] > 0
    shell = replace(ball, faces=ball.faces[kept]).with_normals(ball.normals)
    shown = look_at_textured(shell, looking_at_origin(EYE, 64))
    assert shown.hit.sum() > 500 and ((shown.normals * shown.eye).sum(axis=1) > -0.05).all()


def test_the_bright_box_of_the_studio_turns_anticlockwise(ball: TexturedMesh) -> None:
    shown, _ = seen(ball, white=True)
    sides = {}
    for angle in (0, 90, 180, 270):
        picture = shown.lit(studio_light(UP, FRONT, angle))[..., 0]
        sides[angle] = picture[:, 32:].sum() / picture.sum()
        assert picture[:32].sum() > 1.05 * picture[32:].sum(), "from above"
    assert sides[0] > 0.55 and sides[90] > 0.53 and sides[180] < 0.5 and sides[270] < 0.45, sides


def test_large_maps_are_reduced(ball: TexturedMesh) -> None:
    large = np.repeat(np.repeat(ball.base_color, 8, axis=0), 8, axis=1)
    same = look_at_textured(replace(ball, base_color=large).with_normals(ball.normals), looking_at_origin(EYE, 64))
    shown, _ = seen(ball)
    assert np.abs(same.albedo - shown.albedo).mean() < 0.02
