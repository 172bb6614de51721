"""Displacements against a dense solver and against what can be said by hand."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from mgsr.geometry.displace import integrate_normals, smooth_displacements
from mgsr.geometry.mesh import Mesh
from tests.mesh.shapes import as_mesh, ball

MESH = ball(0.7)


def test_the_laplacian_is_the_mean_of_the_neighbours_less_the_vertex() -> None:
    values = np.random.default_rng(0).normal(size=len(MESH.vertices))
    expected = [values[neighbours].mean() - values[i] for i, neighbours in enumerate(MESH.vertex_neighbors)]
    np.testing.assert_allclose(as_mesh(MESH).laplacian @ values, expected, atol=1e-12)


def test_a_vertex_without_faces_has_an_empty_row() -> None:
    laplacian = Mesh(np.eye(4)[:, :3], np.array([[0, 1, 2]])).laplacian
    assert laplacian[3].nnz == 0 or not laplacian[3].toarray().any()


def test_edge_length_of_an_equal_sided_triangle() -> None:
    corners = 2.0 * np.array([[0, 0, 0], [1, 0, 0], [0.5, 3**0.5 / 2, 0]])
    assert Mesh(corners, np.array([[0, 1, 2]])).edge_length == pytest.approx(2.0)


def test_displacements_are_the_minimum_that_a_dense_solver_finds() -> None:
    mesh = ball(0.7).submesh([np.arange(600)], append=True)
    assert isinstance(mesh, trimesh.Trimesh)
    count = len(mesh.vertices)
    generator = np.random.default_rng(1)
    target, weights = generator.normal(size=count), generator.random(count) + 0.05
    laplacian = as_mesh(mesh).laplacian
    dense = laplacian.toarray()
    expected = np.linalg.solve(np.diag(weights) + 1.5**4 * dense.T @ dense, weights * target)
    found = smooth_displacements(laplacian, target, weights, reach=1.5)
    np.testing.assert_allclose(found, expected, atol=2e-3 * np.abs(expected).max())


def test_bending_a_flat_sheet_to_the_normals_of_a_wave_gives_the_wave() -> None:
    across, along = (axis.ravel() for axis in np.meshgrid(np.linspace(0, 1, 41), np.linspace(0, 1, 41)))
    grid = np.arange(41 * 41).reshape(41, 41)
    a, b, c, d = (part.ravel() for part in (grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]))
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    flat = np.stack([across, along, 0 * across], axis=1)
    wave, slope = 0.02 * np.sin(4 * np.pi * across), 0.08 * np.pi * np.cos(4 * np.pi * across)
    target = np.stack([-slope, 0 * slope, np.ones_like(slope)], axis=1) / np.sqrt(1 + slope**2)[:, None]
    sheet = Mesh(flat, faces)
    confidence = np.ones(len(flat))
    prior_weight, still = np.ones(len(flat)), np.zeros(len(flat))
    moves = integrate_normals(sheet, target, confidence, 1e4, prior_weight, still)
    assert np.abs(moves - wave).max() < 0.002
    assert not integrate_normals(sheet, target, 0 * confidence, 1e4, prior_weight, still).any()
    lifted = integrate_normals(sheet, target, confidence, 1e4, prior_weight, still + 0.3)
    np.testing.assert_allclose(lifted, moves + 0.3, atol=0.002)  # slopes say nothing of the height
    # Half as sure of everything is as half the strength; where little is sure, the sheet stays nearly flat.
    half = integrate_normals(sheet, target, 0.5 * confidence, 1e4, prior_weight, still)
    np.testing.assert_allclose(half, integrate_normals(sheet, target, confidence, 5e3, prior_weight, still), atol=1e-5)
    doubtful = np.where(across > 0.5, 1e-6, 1)
    left = integrate_normals(sheet, target, doubtful, 1e4, prior_weight, still)
    assert np.abs(left[across > 0.7]).max() < 0.002
    assert np.abs(left - wave)[across < 0.3].max() < 0.002


def test_a_surface_whose_normals_are_right_stays_as_it_is() -> None:
    """Check that half a pipe beside a flat strip stays as it is.

    Where they meet, edges do not lie across the mean of their ends' normals.
    """
    turn = np.concatenate([np.zeros(8), np.linspace(0, np.pi, 9)])
    across = np.concatenate([np.linspace(-1.6, -0.2, 8), np.sin(turn[8:])])
    height = np.concatenate([np.zeros(8), 1 - np.cos(turn[8:])])
    along = np.linspace(0, 1, 4)
    pipe = np.stack([np.repeat(across, 4), np.tile(along, len(turn)), np.repeat(height, 4)], axis=1)
    grid = np.arange(len(pipe)).reshape(len(turn), 4)
    a, b, c, d = (part.ravel() for part in (grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]))
    faces = np.concatenate([np.stack([a, c, b], 1), np.stack([a, d, c], 1)])
    mesh, ones = Mesh(pipe, faces), np.ones(len(pipe))
    assert not integrate_normals(mesh, mesh.double_normals, ones, 1e4, ones, 0 * ones).any()
