"""Counts of meshes, and the sampling of images."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from mgsr.geometry.mesh import Mesh
from mgsr.geometry.triangles import Topology, drop_degenerate, drop_small_pieces, topology
from mgsr.mesh.cleanup import seen_sides, turn_outwards
from mgsr.mesh.views import sample
from tests.mesh.shapes import as_mesh, ball, cameras_around, joined, views_of


def test_holes_and_pieces_are_counted() -> None:
    mesh = ball()
    heights = mesh.triangles_center[:, 2]
    two = as_mesh(mesh).keep_faces(np.abs(heights) < 0.5)
    rim = trimesh.Trimesh(two.vertices, two.faces, process=False)
    edges = int((np.bincount(rim.edges_unique_inverse) == 1).sum())
    assert topology(two) == Topology(len(two.vertices), len(two.faces), 1, edges, 2)
    assert topology(as_mesh(mesh)).holes == 0
    both = joined(mesh, ball(0.2).apply_translation([2, 0, 0]))
    assert topology(as_mesh(both)).components == 2


def test_vertex_normals_of_a_ball() -> None:
    mesh = ball(1.0)
    np.testing.assert_allclose(as_mesh(mesh).normals, mesh.vertices, atol=4e-3)


def test_shells_inside_are_unseen_and_turned_pieces_are_turned_back() -> None:
    shells = joined(ball(0.7), ball(0.5))
    faces = np.array(shells.faces)[:, ::-1]
    turned_in = Mesh(np.array(shells.vertices), faces)
    sides = seen_sides(turned_in, views_of(shells, cameras_around(12)), gap=0.01)
    outer = np.linalg.norm(shells.vertices, axis=1) > 0.6
    # At a silhouette the mean normal of the faces around a vertex may point either way.
    assert (sides[outer] == -1).mean() > 0.95 and (sides[~outer] == 0).all()
    turned = turn_outwards(turned_in, sides).faces
    np.testing.assert_array_equal(turned[outer[turned].all(1)], shells.faces[outer[shells.faces].all(1)])


def test_faces_without_area_go() -> None:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0], [np.nan, 0, 0]], float)
    faces = np.array([[0, 1, 2], [0, 0, 1], [0, 1, 3], [0, 1, 4]])
    np.testing.assert_array_equal(drop_degenerate(Mesh(vertices, faces)).faces, [[0, 1, 2]])


def test_the_largest_piece_stays() -> None:
    both = joined(ball(0.7), ball(0.2).apply_translation([2, 0, 0]))
    assert drop_small_pieces(as_mesh(both), min_area=1.0).vertices[:, 0].max() < 1


def test_sampling_is_exact_on_planes() -> None:
    rows, columns = np.mgrid[0:5, 0:6] + 0.5
    image = np.stack([2 * columns + rows, columns - 3 * rows], axis=-1)
    pixels = np.random.default_rng(0).uniform(0.5, 4.5, (30, 2))
    target = np.stack([2 * pixels[:, 0] + pixels[:, 1], pixels[:, 0] - 3 * pixels[:, 1]], axis=-1)
    np.testing.assert_allclose(sample(image, pixels), target, atol=1e-5)


def test_what_is_derived_is_computed_once_and_follows_the_vertices() -> None:
    mesh = as_mesh(ball(1.0))
    assert mesh.normals is mesh.normals and mesh.caster is mesh.caster
    larger = mesh.moved(2 * mesh.vertices)
    assert larger.edge_length == pytest.approx(2 * mesh.edge_length)
    laplacian = mesh.laplacian
    assert mesh.moved(2 * mesh.vertices).laplacian is laplacian, "it depends on the faces alone"


def test_a_scaled_and_shifted_mesh_keeps_its_normals() -> None:
    mesh = as_mesh(ball(1.0))
    assert mesh.in_frame(2 * mesh.vertices + 5).normals is mesh.normals
    given = np.zeros_like(mesh.normals)
    assert mesh.with_normals(given).normals is given and mesh.normals is not given
