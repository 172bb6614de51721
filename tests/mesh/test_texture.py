"""The picture of a mesh, held to surfaces whose colour is known at every place."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from mgsr.config import MeshConfig
from mgsr.mesh.surface import ReconstructedMesh, TexturedMesh
from mgsr.mesh.texture import texture_mesh
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


def read(textured: TexturedMesh, count: int = 4000) -> tuple[np.ndarray, np.ndarray]:
    """Return places [P,3] on the mesh and the texture's bilinear colours 0..1 there, read as a renderer does."""
    random = np.random.default_rng(1)
    faces = textured.faces[random.integers(0, len(textured.faces), count)]
    shares = random.dirichlet([1, 1, 1], count)
    places = np.einsum("pkc,pk->pc", textured.vertices[faces], shares)
    x, y = (np.einsum("pkc,pk->pc", textured.uvs[faces], shares) * len(textured.picture) - 0.5).T
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)
    fx, fy = (x - left)[:, None], (y - top)[:, None]
    last = len(textured.picture) - 1

    def texel(columns: np.ndarray, rows: np.ndarray) -> np.ndarray:
        color: np.ndarray = textured.picture[np.clip(rows, 0, last), np.clip(columns, 0, last)] / 255
        return color

    above = texel(left, top) * (1 - fx) + texel(left + 1, top) * fx
    below = texel(left, top + 1) * (1 - fx) + texel(left + 1, top + 1) * fx
    return places, above * (1 - fy) + below * fy


def test_a_ball_has_its_own_colours_everywhere() -> None:
    shape = ball()
    textured = texture_mesh(surface(shape), views_of(shape, cameras_around(16)), SIDE, None, MeshConfig())
    assert textured.picture.shape == (SIDE, SIDE, 3) and textured.picture.dtype == np.uint8
    assert textured.uvs.min() >= 0 and textured.uvs.max() <= 1
    assert len(textured.faces) == len(shape.faces)
    places, colors = read(textured)
    # Bytes of the picture, the pixels of the views and a texel's size; a seam would show as a large single error.
    assert np.abs(colors - position_color(places)).mean() < 0.006
    assert np.abs(colors - position_color(places)).max() < 0.05


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
    textured = texture_mesh(surface(both), views, SIDE, None, MeshConfig())
    places, colors = read(textured)
    on_wall = places[:, 2] < -0.9
    assert (colors[on_wall, 0] <= GREY + 0.02).all(), "no red on the wall"
    assert (colors[~on_wall, 1] <= GREY + 0.02).all(), "no green on the ball"
    # Where the cameras look, it is painted; what they can't see keeps the mesh's own colour.
    assert (colors[on_wall & (places[:, 2] > -0.951), 1] > 0.9).mean() > 0.5
    np.testing.assert_allclose(colors[places[:, 2] < -1.049], GREY, atol=0.01)


def test_a_mesh_with_many_faces_is_reduced() -> None:
    shape = ball()
    textured = texture_mesh(surface(shape), views_of(shape, cameras_around(8)), 64, 600, MeshConfig())
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
    textured = texture_mesh(surface(shape), views, 64, None, MeshConfig())
    assert textured.picture.min() > 250


@pytest.mark.parametrize("offset", [0.0, 5000.0])
def test_places_stay_where_they_are(offset: float) -> None:
    shape = ball()
    shape.apply_translation([offset, 0, 0])
    cameras = cameras_around(6)
    textured = texture_mesh(surface(shape), views_of(ball(), cameras), 64, None, MeshConfig())
    assert np.abs(np.linalg.norm(textured.vertices - [offset, 0, 0], axis=1) - 0.7).max() < 1e-6
