"""Noise taken from a mesh: against the formula written out, and on shapes whose normals are known."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from mgsr.config.expert import BilateralOptions
from mgsr.geometry import bilateral_filter
from mgsr.geometry.bilateral_filter import bilateral_normal_filter
from mgsr.geometry.mesh import Mesh
from tests.mesh.shapes import ball

ANGLE = 17.0


def unit(vectors: np.ndarray) -> np.ndarray:
    normalised: np.ndarray = vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
    return normalised


def tilt(vertices: np.ndarray, faces: np.ndarray, normals: np.ndarray) -> float:
    """Return the faces' mean angle, in degrees, to the unit normals [F,3]."""
    cosines = (unit(Mesh(vertices, faces).face_crosses) * normals).sum(1)
    return float(np.degrees(np.arccos(np.clip(cosines, -1, 1))).mean())


def written_out(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Compute what `bilateral_normal_filter` does, face by face and vertex by vertex."""
    crosses, middles = Mesh(vertices, faces).face_crosses, vertices[faces].mean(axis=1)
    areas, normals = np.linalg.norm(crosses, axis=1), unit(crosses)
    edge = np.mean([np.linalg.norm(vertices[face[i]] - vertices[face[i - 1]]) for face in faces for i in range(3)])
    corners = [set(face) for face in faces.tolist()]
    around = [[j for j, other in enumerate(corners) if face & other] for face in corners]
    owned = [[j for j, face in enumerate(corners) if v in face] for v in range(len(vertices))]
    for _ in range(BilateralOptions().rounds):
        means = []
        for i, others in enumerate(around):
            apart = np.linalg.norm(middles[others] - middles[i], axis=1) / edge
            unlike = np.linalg.norm(normals[others] - normals[i], axis=1) / np.radians(ANGLE)
            means.append((areas[others] * np.exp(-(apart**2) / 2) * np.exp(-(unlike**2) / 2)) @ normals[others])
        normals = unit(np.array(means))
    for _ in range(BilateralOptions().steps):
        middles, moved = vertices[faces].mean(axis=1), vertices.copy()
        for v, own in enumerate(owned):
            moved[v] += np.mean([normals[j] * (normals[j] @ (middles[j] - vertices[v])) for j in own], axis=0)
        vertices = moved
    return vertices


def noisy(vertices: np.ndarray, size: float) -> np.ndarray:
    return vertices + np.random.default_rng(3).normal(scale=size, size=vertices.shape)


def test_it_is_the_published_filter() -> None:
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=0.7)
    rough = noisy(mesh.vertices, 0.01)
    found = bilateral_normal_filter(Mesh(rough, mesh.faces), ANGLE).vertices
    np.testing.assert_allclose(found, written_out(rough, mesh.faces), atol=2e-6)
    assert np.abs(found - rough).max() > 0.005


def test_facets_held_in_memory_by_parts_come_to_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=0.7)
    rough = noisy(mesh.vertices, 0.01)
    whole = bilateral_normal_filter(Mesh(rough, mesh.faces), ANGLE).vertices
    monkeypatch.setattr(bilateral_filter, "CHUNK", 77)
    np.testing.assert_allclose(bilateral_normal_filter(Mesh(rough, mesh.faces), ANGLE).vertices, whole, atol=1e-7)


def test_it_takes_the_noise_and_leaves_the_ball() -> None:
    mesh = ball(0.7)
    rough = noisy(mesh.vertices, 0.0015)
    smooth = bilateral_normal_filter(Mesh(rough, mesh.faces), ANGLE).vertices
    truth = unit(mesh.vertices[mesh.faces].mean(axis=1))
    assert tilt(smooth, mesh.faces, truth) < 0.4 * tilt(rough, mesh.faces, truth)
    radii = np.linalg.norm(smooth, axis=1)
    assert radii.mean() == pytest.approx(0.7, abs=2e-4)
    assert radii.std() < 0.6 * np.linalg.norm(rough, axis=1).std()


def test_creases_stay() -> None:
    """Check that a box keeps its edges, which a Laplacian of the same effect on the sides takes off."""
    box = trimesh.creation.box((1, 1, 1))
    for _ in range(5):
        box = box.subdivide()
    edge_on = (np.abs(np.abs(box.vertices) - 0.5) < 1e-9).sum(1) >= 2
    rough = noisy(box.vertices, 0.001)
    smooth = bilateral_normal_filter(Mesh(rough, box.faces), ANGLE).vertices
    rounded = trimesh.smoothing.filter_laplacian(trimesh.Trimesh(rough, box.faces, process=False), iterations=3)
    truth = unit(Mesh(box.vertices, box.faces).face_crosses)
    assert tilt(smooth, box.faces, truth) < 0.3 * tilt(rough, box.faces, truth)

    def off(vertices: np.ndarray) -> float:
        return float(np.linalg.norm(vertices - box.vertices, axis=1)[edge_on].mean())

    assert off(smooth) < 1.2 * off(rough) < 0.5 * off(np.asarray(rounded.vertices))


def test_needles_are_not_turned_over() -> None:
    """Check that needle-shaped faces, such as marching cubes makes, are not turned over.

    Numbers as coarse as a file's must come to an end too.
    """
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=0.7)
    ends = mesh.edges_unique[::7]
    pulled = mesh.vertices.astype(np.float32)
    pulled[ends[:, 0]] = 0.03 * pulled[ends[:, 0]] + 0.97 * pulled[ends[:, 1]]

    def turned(vertices: np.ndarray) -> int:
        out = unit(vertices[mesh.faces].mean(axis=1))
        return int(((unit(Mesh(vertices, mesh.faces).face_crosses) * out).sum(1) < 0.7).sum())

    # The filter alone turns five times as many as there were.
    assert turned(bilateral_normal_filter(Mesh(pulled, mesh.faces), ANGLE).vertices) < 1.2 * turned(pulled)


def test_a_flat_sheet_with_a_rim_stays_as_it_is() -> None:
    box = trimesh.creation.box((1, 1, 1)).subdivide().subdivide()
    sheet = box.submesh([np.flatnonzero(box.triangles_center[:, 2] > 0.499)], append=True)
    np.testing.assert_allclose(
        bilateral_normal_filter(Mesh(sheet.vertices, sheet.faces), ANGLE).vertices, sheet.vertices, atol=1e-12
    )


def test_what_has_no_faces_stays() -> None:
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [5, 5, 5]])
    nothing = np.zeros((0, 3), np.int64)
    np.testing.assert_array_equal(bilateral_normal_filter(Mesh(vertices, nothing), ANGLE).vertices, vertices)
    np.testing.assert_allclose(
        bilateral_normal_filter(Mesh(vertices, np.array([[0, 1, 2]])), ANGLE).vertices, vertices, atol=1e-12
    )
