"""Waves taken off a mesh: against the fit written out, and on shapes whose surface is known."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from mgsr.config.expert import LowFrequencyOptions
from mgsr.geometry import low_frequency
from mgsr.geometry.low_frequency import smooth_low_frequency
from mgsr.geometry.mesh import Mesh
from tests.geometry.test_bilateral_filter import tilt, unit
from tests.mesh.shapes import ball

ANGLE = 4.0
OPTIONS = LowFrequencyOptions()
RADIUS = 0.7


def waved(vertices: np.ndarray, length: float, slope: float) -> np.ndarray:
    """Move vertices outwards and inwards in waves of this length, which tilt the surface by at most `slope` degrees."""
    phases = 2 * np.pi / length * vertices
    heights = np.radians(slope) * length / (2 * np.pi) * np.sin(phases[:, 0]) * np.sin(phases[:, 1])
    moved: np.ndarray = vertices + heights[:, None] * unit(vertices)
    return moved


def off_the_ball(vertices: np.ndarray) -> float:
    return float(np.abs(np.linalg.norm(vertices, axis=1) - RADIUS).mean())


def fitted(places: np.ndarray, faces: np.ndarray, normals: np.ndarray, angle: float) -> np.ndarray:
    """Compute what `_fitted_normals` does, by least squares at each vertex."""
    areas = np.zeros(len(places))
    for face, area in zip(faces, trimesh.Trimesh(places, faces, process=False).area_faces, strict=True):
        areas[face] += area / 3
    for _ in range(OPTIONS.rounds):
        found = []
        for place, own in zip(places, normals, strict=True):
            near = np.linalg.norm(places - place, axis=1) <= OPTIONS.far
            ways, others = places[near] - place, normals[near]
            unlike = np.linalg.norm(others - own, axis=1) / angle
            weights = areas[near] * np.exp(-(ways**2).sum(1) / 2 - unlike**2 / 2)
            side = unit(np.cross(own, np.eye(3)[np.abs(own).argmin()]))
            flat = ways @ np.stack([side, np.cross(own, side)]).T
            root, held = np.sqrt(weights)[:, None], np.sqrt(OPTIONS.regularization * weights.sum()) * np.eye(2)
            middle = (weights @ flat) / weights.sum()
            table = np.block([[root, root * (flat - middle)], [np.zeros((2, 1)), held]])
            fit = np.linalg.lstsq(table, np.concatenate([root * others, np.zeros((2, 3))]), rcond=None)[0]
            found.append(fit[0] - middle @ fit[1:])
        normals = unit(np.array(found))
    return normals


def test_it_is_the_fit_written_out() -> None:
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=2.5)
    places = mesh.vertices + np.random.default_rng(3).normal(scale=0.05, size=mesh.vertices.shape)
    normals = Mesh(places, mesh.faces).double_normals
    found = low_frequency._fitted_normals(Mesh(places, mesh.faces), 1 / OPTIONS.reach, np.radians(12.0), OPTIONS)
    np.testing.assert_allclose(
        found, fitted(places, mesh.faces, normals, np.radians(12.0)), atol=1e-7
    )  # lengths of normals are float32
    assert np.degrees(np.arccos((found * normals).sum(1))).mean() > 1


@pytest.mark.parametrize(("length", "left"), [(5, 0.6), (10, 0.75)])
def test_short_waves_go_and_roundness_stays(length: float, left: float) -> None:
    mesh = ball(RADIUS)
    unit_length = Mesh(mesh.vertices, mesh.faces).edge_length
    rough = waved(mesh.vertices, length * unit_length, slope=3.0)
    smooth = smooth_low_frequency(Mesh(rough, mesh.faces), unit_length, ANGLE).vertices
    assert off_the_ball(smooth) < left * off_the_ball(rough)
    true = unit(mesh.vertices[mesh.faces].mean(axis=1))
    assert tilt(smooth, mesh.faces, true) < left * tilt(rough, mesh.faces, true)
    clean = smooth_low_frequency(Mesh(mesh.vertices, mesh.faces), unit_length, ANGLE).vertices
    assert off_the_ball(clean) < 0.001 * unit_length


def test_the_large_shape_stays() -> None:
    mesh = ball(RADIUS)
    unit_length = Mesh(mesh.vertices, mesh.faces).edge_length
    wide = waved(mesh.vertices, 40 * unit_length, slope=3.0)
    moved = np.linalg.norm(smooth_low_frequency(Mesh(wide, mesh.faces), unit_length, ANGLE).vertices - wide, axis=1)
    assert moved.mean() < 0.05 * off_the_ball(wide)


@pytest.mark.slow
def test_creases_stay_while_waves_on_the_faces_beside_them_go() -> None:
    box = trimesh.creation.box((1, 1, 1))
    for _ in range(6):
        box = box.subdivide()
    unit_length = Mesh(box.vertices, box.faces).edge_length
    kept = smooth_low_frequency(Mesh(box.vertices, box.faces), unit_length, ANGLE).vertices
    assert np.abs(kept - box.vertices).max() < 0.06 * unit_length
    inside = np.sort(np.abs(box.vertices), axis=1)[:, 1] < 0.5 - 6 * unit_length
    phases = 2 * np.pi / (8 * unit_length) * box.vertices
    rough = box.vertices * (1 + 0.05 * unit_length * inside * np.prod(np.cos(phases), axis=1))[:, None]
    smooth = smooth_low_frequency(Mesh(rough, box.faces), unit_length, ANGLE).vertices
    before, after = (np.abs(each - box.vertices) for each in (rough, smooth))
    assert after[inside].mean() < 0.7 * before[inside].mean()
    assert after[~inside].max() < 0.06 * unit_length


def test_a_mesh_without_faces_is_given_back() -> None:
    mesh = Mesh(np.eye(3), np.zeros((0, 3), np.int64))
    assert smooth_low_frequency(mesh, 0.1, ANGLE) is mesh
