"""Charts of surfaces, judged by areas and by rays through the flat charts."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from mgsr.config.expert import ChartOptions
from mgsr.geometry.charts import Charts, cut_charts
from mgsr.geometry.mesh import Mesh


def as_charts(shape: trimesh.Trimesh) -> tuple[Mesh, Charts]:
    mesh = Mesh(np.asarray(shape.vertices, np.float64), np.asarray(shape.faces, np.int64))
    area = float(shape.area)
    return mesh, cut_charts(mesh, 1e-5 * area)


SHAPES = {
    "box": trimesh.creation.box((1.0, 2.0, 3.0)),
    "ball": trimesh.creation.icosphere(4),
    "torus": trimesh.creation.torus(1.0, 0.4, major_sections=96, minor_sections=48),
}


@pytest.mark.parametrize("name", SHAPES)
def test_charts_are_few_and_keep_the_surface(name: str) -> None:
    shape = SHAPES[name]
    mesh, charts = as_charts(shape)
    np.testing.assert_array_equal(charts.origin[charts.faces], mesh.faces)
    assert 6 <= charts.count <= 24
    flat = trimesh.Trimesh(np.column_stack([charts.places, np.zeros(len(charts.places))]), charts.faces, process=False)
    shrunk = flat.area_faces / shape.area_faces
    assert shrunk.max() < 1 + 1e-6 and shrunk.min() > 0.5 * ChartOptions().min_cosine
    # With y down, counter-clockwise faces have a negative z.
    assert (flat.triangles_cross[:, 2] < 0).all(), "none is turned over"


@pytest.mark.parametrize("name", SHAPES)
def test_no_chart_covers_itself(name: str) -> None:
    """Check that a ray through the flat charts meets the same face from both sides."""
    _, charts = as_charts(SHAPES[name])
    flat = np.column_stack([charts.places, np.zeros(len(charts.places))])
    # Faces at different heights, so that rays from the two sides differ where faces overlap.
    corners = flat[charts.faces] + np.linspace(0, 1, len(charts.faces))[:, None, None] * [0, 0, 1]
    caster = Mesh(corners.reshape(-1, 3), np.arange(corners.shape[0] * 3).reshape(-1, 3)).caster
    middles = corners.mean(axis=1)
    for side in (5.0, -5.0):
        origins = middles + np.array([0, 0, side])
        hits = caster.cast_rays(origins, np.broadcast_to([0, 0, -np.sign(side)], origins.shape))
        np.testing.assert_array_equal(hits.face, np.arange(len(corners)))


def test_a_coil_is_cut_where_it_covers_itself() -> None:
    """Check a winding ramp: all of it faces up, and each turn covers the one below."""
    turn = np.linspace(0, 6 * np.pi, 400)
    rim = [np.stack([r * np.cos(turn), r * np.sin(turn), 0.1 * turn], axis=1) for r in (0.5, 1.0)]
    vertices = np.stack(rim, axis=1).reshape(-1, 3)
    start = 2 * np.arange(len(turn) - 1)[:, None]
    faces = np.concatenate([start + np.array(corners) for corners in ([0, 1, 2], [1, 3, 2])])
    mesh = Mesh(vertices, faces)
    charts = cut_charts(mesh, 1e-3)
    assert charts.count >= 3
    flat = np.round(charts.places[charts.faces].mean(axis=1), 6)
    assert len(np.unique(flat, axis=0)) == len(flat), "no two faces lie on each other"


def test_small_charts_join_their_neighbours() -> None:
    """Check a bumpy ball, on which many single faces look another way than those around them."""
    shape = trimesh.creation.icosphere(4)
    bumps = np.random.default_rng(0).normal(1, 0.02, (len(shape.vertices), 1))
    mesh = Mesh(np.asarray(shape.vertices) * bumps, np.asarray(shape.faces))
    apart = cut_charts(mesh, 0.0, ChartOptions(smoothing=0, small=0.0))
    assert apart.count > 3 * cut_charts(mesh, 0.0, ChartOptions(smoothing=0)).count
