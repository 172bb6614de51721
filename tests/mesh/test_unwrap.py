"""Tangent spaces, against surfaces where they are known."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from mgsr.geometry.mesh import Mesh
from mgsr.mesh.unwrap import tangent_space, unwrap


@pytest.mark.parametrize("mirrored", [False, True])
def test_tangents_of_a_globe_point_east(mirrored: bool) -> None:
    """Check a globe on an equirectangular picture: tangents point east, and bitangents north (glTF: up the picture).

    On a mirrored picture tangents point west, and the sign turns the bitangents north again.
    """
    east, south = np.meshgrid(np.linspace(0, 2 * np.pi, 81), np.linspace(0.5, np.pi - 0.5, 41))
    vertices = np.stack([np.sin(south) * np.cos(east), np.sin(south) * np.sin(east), np.cos(south)], -1).reshape(-1, 3)
    index = np.arange(vertices.shape[0]).reshape(east.shape)
    first = np.stack([index[:-1, :-1], index[1:, :-1], index[:-1, 1:]], -1).reshape(-1, 3)
    second = np.stack([index[:-1, 1:], index[1:, :-1], index[1:, 1:]], -1).reshape(-1, 3)
    places = np.stack([-east if mirrored else east, south], -1).reshape(-1, 2)
    mesh = Mesh(vertices, np.concatenate([first, second])).with_normals(vertices.astype(np.float32))
    tangents = tangent_space(mesh, places)
    towards_east = np.stack([-np.sin(east), np.cos(east), 0 * east], -1).reshape(-1, 3)
    north = np.cross(vertices, towards_east)
    turn = -1 if mirrored else 1
    np.testing.assert_allclose(tangents[:, :3], turn * towards_east, atol=0.05)
    bitangents = tangents[:, 3:] * np.cross(vertices, tangents[:, :3])
    np.testing.assert_allclose(bitangents, north, atol=0.05)
    np.testing.assert_allclose(np.linalg.norm(tangents[:, :3], axis=1), 1, atol=1e-6)


def test_a_face_without_area_has_a_tangent_too() -> None:
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]])
    mesh = Mesh(vertices, np.array([[0, 1, 2]])).with_normals(np.tile(np.array([0, 0, 1], np.float32), (3, 1)))
    tangents = tangent_space(mesh, np.zeros((3, 2)))
    np.testing.assert_allclose(np.linalg.norm(tangents[:, :3], axis=1), 1, atol=1e-6)
    assert (np.abs(tangents[:, 3]) == 1).all() and np.abs(tangents[:, 2]).max() < 1e-6


def _plate(across: np.ndarray, height: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the vertices, the faces and the vertices' indices [41,C] of a plate of 40 steps along, at a height."""
    x, y = np.meshgrid(across, np.arange(41.0))
    index = np.arange(x.size).reshape(x.shape)
    here, right, below, beyond = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    faces = np.concatenate([np.stack([here, right, below], -1), np.stack([right, beyond, below], -1)]).reshape(-1, 3)
    return np.stack([x, y, 0 * x + height], -1).reshape(-1, 3), faces, index


def _plate_with_fins() -> tuple[Mesh, int]:
    """Return a square plate with an upright fin on each step of a diagonal, and the number of fins."""
    plate, faces, index = _plate(np.arange(41.0), 0)
    ends = index[np.arange(40), np.arange(40)], index[np.arange(40), np.arange(1, 41)]
    tips = plate[ends[0]] * 0.5 + plate[ends[1]] * 0.5 + np.array([0, 0, 0.3])
    fins = np.stack([*ends, len(plate) + np.arange(40)], -1)
    fins[::2] = fins[::2, ::-1]  # their normals add up to zero, so the chart is that of the plate
    return Mesh(np.concatenate([plate, tips]), np.concatenate([faces, fins])), 40


def _step() -> tuple[Mesh, int]:
    """Return two plates of different heights with a low upright wall between them, and the wall's number of faces."""
    (low, low_faces, one), (high, high_faces, other) = _plate(np.arange(21.0), 0), _plate(np.arange(20.0, 41.0), 0.05)
    foot, top = one[:, -1], len(low) + other[:, 0]
    wall = [np.stack([foot[:-1], top[:-1], foot[1:]], -1), np.stack([foot[1:], top[:-1], top[1:]], -1)]
    faces = np.concatenate([low_faces, len(low) + high_faces, *wall])
    return Mesh(np.concatenate([low, high]), faces), 80


@pytest.mark.parametrize("shape", [_plate_with_fins, _step])
@pytest.mark.parametrize("side", [None, 256])
def test_no_face_is_longer_in_the_atlas_than_on_the_surface(
    side: int | None, shape: Callable[[], tuple[Mesh, int]]
) -> None:
    """Check edge-on faces: a projection only shortens edges, but xatlas leaves the tips of fins where they were."""
    (mesh, upright), texel = shape(), 0.5
    unwrapped = unwrap(mesh.with_normals(mesh.normals), texel, side)
    np.testing.assert_array_equal(unwrapped.vertices[unwrapped.faces], mesh.vertices[mesh.faces])

    def edges(corners: np.ndarray) -> np.ndarray:
        return np.asarray(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2))

    flat = edges((unwrapped.uvs * unwrapped.size[::-1])[unwrapped.faces].astype(np.float64))
    solid = edges(mesh.vertices[mesh.faces])
    per_unit = 1 / texel if side is None else float(np.median(flat / solid))
    # xatlas rounds the sizes of charts up to whole texels.
    assert (flat < 1.1 * per_unit * solid + 1).all()
    assert (flat[:-upright] > 0.9 * per_unit * solid[:-upright]).all()
