"""Tangent spaces, against surfaces where they are known."""

from __future__ import annotations

import numpy as np
import pytest

from mgsr.geometry.mesh import Mesh
from mgsr.mesh.unwrap import tangent_space


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
