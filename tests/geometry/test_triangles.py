"""Counts of meshes, and the sampling of images."""

from __future__ import annotations

import numpy as np
import trimesh

from mgsr.geometry.triangles import (
    Topology,
    drop_degenerate,
    drop_small_pieces,
    keep_faces,
    topology,
    vertex_normals,
)
from mgsr.mesh.cleanup import seen_sides, turn_outwards
from mgsr.mesh.views import sample
from tests.mesh.shapes import ball, cameras_around, joined, views_of


def test_holes_and_pieces_are_counted() -> None:
    mesh = ball()
    heights = mesh.triangles_center[:, 2]
    two = keep_faces(mesh.vertices, mesh.faces, np.abs(heights) < 0.5)
    rim = trimesh.Trimesh(*two, process=False)
    edges = int((np.bincount(rim.edges_unique_inverse) == 1).sum())
    assert topology(*two) == Topology(len(two[0]), len(two[1]), 1, edges, 2)
    assert topology(mesh.vertices, mesh.faces).holes == 0
    both = joined(mesh, ball(0.2).apply_translation([2, 0, 0]))
    assert topology(both.vertices, both.faces).components == 2


def test_vertex_normals_of_a_ball() -> None:
    mesh = ball(1.0)
    np.testing.assert_allclose(vertex_normals(mesh.vertices, mesh.faces), mesh.vertices, atol=4e-3)


def test_shells_inside_are_unseen_and_turned_pieces_are_turned_back() -> None:
    shells = joined(ball(0.7), ball(0.5))
    faces = np.array(shells.faces)[:, ::-1]
    sides = seen_sides(np.array(shells.vertices), faces, views_of(shells, cameras_around(12)), gap=0.01)
    outer = np.linalg.norm(shells.vertices, axis=1) > 0.6
    # At a silhouette the mean normal of the faces around a vertex may point either way.
    assert (sides[outer] == -1).mean() > 0.95 and (sides[~outer] == 0).all()
    turned = turn_outwards(faces, sides)
    np.testing.assert_array_equal(turned[outer[turned].all(1)], shells.faces[outer[shells.faces].all(1)])


def test_faces_without_area_go() -> None:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0], [np.nan, 0, 0]], float)
    faces = np.array([[0, 1, 2], [0, 0, 1], [0, 1, 3], [0, 1, 4]])
    np.testing.assert_array_equal(drop_degenerate(vertices, faces)[1], [[0, 1, 2]])


def test_the_largest_piece_stays() -> None:
    both = joined(ball(0.7), ball(0.2).apply_translation([2, 0, 0]))
    vertices, _ = drop_small_pieces(np.array(both.vertices), np.array(both.faces), min_area=1.0)
    assert vertices[:, 0].max() < 1


def test_sampling_is_exact_on_planes() -> None:
    rows, columns = np.mgrid[0:5, 0:6] + 0.5
    image = np.stack([2 * columns + rows, columns - 3 * rows], axis=-1)
    pixels = np.random.default_rng(0).uniform(0.5, 4.5, (30, 2))
    wanted = np.stack([2 * pixels[:, 0] + pixels[:, 1], pixels[:, 0] - 3 * pixels[:, 1]], axis=-1)
    np.testing.assert_allclose(sample(image, pixels), wanted, atol=1e-5)
