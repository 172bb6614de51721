"""The textured model, held to surfaces whose colour and normals are known at every place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from mgsr.config import MeshConfig, OutputConfig
from mgsr.config.expert import MeshOptions, TextureOptions
from mgsr.data.images import linear_to_srgb, srgb_to_linear
from mgsr.mesh.surface import ReconstructedMesh, TexturedMesh
from mgsr.mesh.texture import texture_levels
from mgsr.mesh.views import SurfaceView
from mgsr.shading.material import Material
from tests.mesh.shapes import cameras_around, joined, position_color, views_of

SIDE = 256
GREY = 0.5


def ball() -> trimesh.Trimesh:
    sphere: trimesh.Trimesh = trimesh.creation.icosphere(3, 0.7)
    return sphere


def surface(mesh: trimesh.Trimesh) -> ReconstructedMesh:
    """Return a mesh with grey vertices, so that what a texture shows can only come from the views."""
    vertices, faces = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64)
    return ReconstructedMesh(vertices, faces, np.full(vertices.shape, GREY, np.float32))


def textured_of(
    shape: trimesh.Trimesh, views: Sequence[SurfaceView], side: int = SIDE, faces: int | None = None
) -> TexturedMesh:
    """Return the textured model of a shape, whose colours contain no shading."""
    return texture_levels(
        surface(shape), views, 0.02, OutputConfig(faces=faces, texture=side), MeshConfig(), shaded=False
    )[0]


def read(textured: TexturedMesh, picture: np.ndarray, count: int = 4000) -> tuple[np.ndarray, np.ndarray]:
    """Return places [P,3] on the mesh and a picture's bilinear values 0..1 there, read as a renderer does."""
    random = np.random.default_rng(1)
    faces = textured.faces[random.integers(0, len(textured.faces), count)]
    shares = random.dirichlet([1, 1, 1], count)
    places = np.einsum("pkc,pk->pc", textured.vertices[faces], shares)
    x, y = (np.einsum("pkc,pk->pc", textured.uvs[faces], shares) * len(picture) - 0.5).T
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)
    fx, fy = (x - left)[:, None], (y - top)[:, None]
    last = len(picture) - 1

    def texel(columns: np.ndarray, rows: np.ndarray) -> np.ndarray:
        color: np.ndarray = picture[np.clip(rows, 0, last), np.clip(columns, 0, last)] / 255
        return color

    above = texel(left, top) * (1 - fx) + texel(left + 1, top) * fx
    below = texel(left, top + 1) * (1 - fx) + texel(left + 1, top + 1) * fx
    return places, above * (1 - fy) + below * fy


def test_a_ball_has_its_own_colours_everywhere() -> None:
    shape = ball()
    textured = textured_of(shape, views_of(shape, cameras_around(16)))
    assert textured.base_color.shape == (SIDE, SIDE, 3) and textured.base_color.dtype == np.uint8
    assert textured.uvs.min() >= 0 and textured.uvs.max() <= 1
    assert len(textured.faces) == len(shape.faces)
    places, colors = read(textured, textured.base_color)
    # Bytes of the picture, the pixels of the views and a texel's size; a seam would show as a large single error.
    assert np.abs(colors - position_color(places)).mean() < 0.006
    assert np.abs(colors - position_color(places)).max() < 0.05


@pytest.mark.parametrize("brightness", [0.4, 0.01])
def test_the_light_that_gloss_tells_is_divided_out(brightness: float) -> None:
    """Check that the base colour is the albedo, and at most the brightest one where the light is not believed."""
    shape, light = ball(), brightness * np.array([1.0, 0.8, 0.5])
    albedo = np.array([0.6, 0.5, 0.3])
    shown = linear_to_srgb(0.4 * np.array([1.0, 0.8, 0.5]) * albedo).astype(np.float32)
    views = [
        replace(view, color=np.broadcast_to(shown, view.color.shape)) for view in views_of(shape, cameras_around(8))
    ]
    full = surface(shape)
    full = replace(full, colors=np.broadcast_to(shown, full.colors.shape))
    glossy = Material(0.3, (0.2, 0.4), light=np.broadcast_to(light, (8, 16, 3)))
    textured = texture_levels(full, views, 0.02, OutputConfig(texture=SIDE), MeshConfig(), material=glossy)[0]
    _, colors = read(textured, textured.base_color)
    expected = albedo if brightness == 0.4 else albedo * 0.9 / 0.6
    np.testing.assert_allclose(srgb_to_linear(colors).mean(axis=0), expected, rtol=0.03)


def test_matte_surfaces_have_the_light_that_was_divided_out() -> None:
    shape = ball()
    textured = texture_levels(
        surface(shape), views_of(shape, cameras_around(8)), 0.02, OutputConfig(texture=64), MeshConfig()
    )[0]
    mean = textured.material.mean_light()
    assert textured.material.matte and mean is not None
    np.testing.assert_allclose(mean, 1, atol=0.02)
    assert textured_of(shape, views_of(shape, cameras_around(4)), 64).material.light is None


def test_nothing_is_painted_through_the_object() -> None:
    """Check that the wall behind a red ball does not become red.

    The ball hides half of a green wall from the only cameras.
    """
    ball_, wall = trimesh.creation.icosphere(3, 0.4), trimesh.creation.box((3, 3, 0.1))
    wall.apply_translation([0, 0, -1])
    both = joined(ball_, wall)
    views = []
    for view in views_of(both, [camera for camera in cameras_around(40, 4.0, 128) if camera.center[2] > 3.2]):
        ball_seen = view.depth < 4.0
        color = np.where(ball_seen[..., None], [1.0, 0, 0], [0, 1.0, 0]).astype(np.float32)
        views.append(type(view)(view.camera, view.depth, view.normal, view.alpha, color))
    assert len(views) >= 2
    textured = textured_of(both, views)
    places, colors = read(textured, textured.base_color)
    on_wall = places[:, 2] < -0.9
    assert (colors[on_wall, 0] <= GREY + 0.02).all(), "no red on the wall"
    assert (colors[~on_wall, 1] <= GREY + 0.02).all(), "no green on the ball"
    # Where the cameras look, it is painted; what they can't see keeps the mesh's own colour.
    assert (colors[on_wall & (places[:, 2] > -0.951), 1] > 0.9).mean() > 0.5
    np.testing.assert_allclose(colors[places[:, 2] < -1.049], GREY, atol=0.01)


def test_a_mesh_with_many_faces_is_reduced() -> None:
    shape = ball()
    textured = textured_of(shape, views_of(shape, cameras_around(8)), 64, 600)
    assert 500 <= len(textured.faces) <= 600
    assert np.abs(np.linalg.norm(textured.vertices, axis=1) - 0.7).max() < 0.03


def test_no_texel_is_left_dark_beside_a_chart() -> None:
    """Check that the texture is bright everywhere.

    A background of another colour would be mixed in at the charts' edges in smaller copies.
    """
    shape = ball()
    views = [
        type(view)(view.camera, view.depth, view.normal, view.alpha, np.ones_like(view.color))
        for view in views_of(shape, cameras_around(16))
    ]
    textured = textured_of(shape, views, 64)
    assert textured.base_color.min() > 250


@pytest.mark.parametrize("offset", [0.0, 5000.0])
def test_places_stay_where_they_are(offset: float) -> None:
    shape = ball()
    shape.apply_translation([offset, 0, 0])
    textured = textured_of(shape, views_of(ball(), cameras_around(6)), 64)
    assert np.abs(np.linalg.norm(textured.vertices - [offset, 0, 0], axis=1) - 0.7).max() < 1e-6


@pytest.mark.slow
def test_the_normal_map_brings_back_what_decimation_takes() -> None:
    """Check a ball with waves against its normals by calculus, with glTF's tangent space written out anew."""
    fine = trimesh.creation.icosphere(6, 1.0)
    shape = trimesh.Trimesh(fine.vertices * (0.7 + 0.02 * np.sin(12 * fine.vertices[:, 2:])), fine.faces, process=False)
    textured = textured_of(shape, views_of(shape, cameras_around(4)), 512, 1500)
    faces, shares = textured.faces[::3], np.full(3, 1 / 3)
    corners = textured.uvs[faces].mean(axis=1) * 512 - 0.5
    columns, rows = np.rint(corners).astype(int).T
    inside = np.abs(corners - np.rint(corners)).max(axis=1) < 0.15  # at a texel's centre
    stored = textured.normal_map[rows, columns].astype(float) / 255 * 2 - 1
    normal = np.einsum("pkc,k->pc", textured.normals[faces], shares)
    tangent = np.einsum("pkc,k->pc", textured.tangents[faces][..., :3], shares)
    sign = textured.tangents[faces[:, 0], 3:]
    bitangent = sign * np.cross(normal, tangent)
    shaded = stored[:, :1] * tangent + stored[:, 1:2] * bitangent + stored[:, 2:] * normal
    shaded /= np.linalg.norm(shaded, axis=1, keepdims=True)
    places = textured.vertices[faces].mean(axis=1)
    truth = _wave_normals(places)
    angles = [np.degrees(np.arccos(np.clip((each * truth).sum(1), -1, 1)))[inside] for each in (shaded, normal)]
    assert inside.sum() > 20
    assert np.median(angles[0]) < 2.0 < np.median(angles[1])


def _wave_normals(places: np.ndarray) -> np.ndarray:
    """Return the normals [P,3] of the surface r = 0.7 + 0.02 sin(12 z / r), by its gradient."""
    radius = np.linalg.norm(places, axis=1, keepdims=True)
    up = places / radius
    slope = 0.02 * 12 * np.cos(12 * up[:, 2:]) / radius * ([[0.0, 0, 1]] - up[:, 2:] * up)
    gradient = up - slope
    return np.asarray(gradient / np.linalg.norm(gradient, axis=1, keepdims=True))


def test_inside_a_bowl_half_of_the_sky_is_hidden() -> None:
    """Check a half ball seen from inside: the rest of it hides half the sky from each of its places."""
    whole = trimesh.creation.icosphere(5, 0.7)
    bowl = trimesh.Trimesh(whole.vertices, whole.faces[whole.triangles_center[:, 2] < 0][:, ::-1])
    textured = textured_of(bowl, views_of(bowl, cameras_around(8)), 64)
    places, occlusion = read(textured, np.repeat(textured.occlusion[..., None], 3, axis=2))
    assert np.abs(occlusion[places[:, 2] < -0.1].mean(axis=0) - 0.5).max() < 0.03
    outside = textured_of(whole, views_of(whole, cameras_around(4)), 64)
    assert outside.occlusion.min() == 255


def test_a_texel_is_as_large_as_asked() -> None:
    shape = ball()
    views = views_of(shape, cameras_around(4))
    options = MeshOptions(texture=TextureOptions(texel=0.5))
    levels = texture_levels(surface(shape), views, 0.02, OutputConfig(), MeshConfig(), shaded=False, options=options)
    textured = levels[0]
    flat = textured.uvs * textured.size[::-1]
    corners, places = flat[textured.faces], textured.vertices[textured.faces]
    stretch = np.linalg.norm(np.diff(places[:, :2], axis=1), axis=-1) / np.linalg.norm(
        np.diff(corners[:, :2], axis=1), axis=-1
    )
    assert 0.0095 < np.percentile(stretch, 10) < 0.0105, "along the charts"


def test_levels_of_detail_have_a_quarter_of_the_faces_and_half_of_the_texels() -> None:
    shape: trimesh.Trimesh = trimesh.creation.icosphere(5, 0.7)
    views = views_of(shape, cameras_around(12))
    output = OutputConfig(faces=10_000, texture=SIDE, lods=8)
    levels = texture_levels(surface(shape), views, 0.02, output, MeshConfig(), shaded=False)
    assert [len(each.faces) for each in levels] == pytest.approx([10_000, 2_500, 625], rel=0.02), "500 at least"
    assert [max(each.size) for each in levels] == [SIDE, SIDE // 2, SIDE // 4]
    for level in levels:
        places, colors = read(level, level.base_color)
        assert np.abs(np.linalg.norm(places, axis=1) - 0.7).mean() < 0.003
        assert np.abs(colors - position_color(places)).mean() < 0.003
