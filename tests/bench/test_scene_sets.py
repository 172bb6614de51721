"""The benchmark's scenes: two sets with every kind in each, arguments that the renderer takes, and solids as drawn."""

from __future__ import annotations

import argparse
import math
import sys
from argparse import ArgumentParser
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh

from benchmarks.render_scenes import (
    BOWL_THICKNESS,
    CAP_THICKNESS,
    CUP_THICKNESS,
    GILL_THICKNESS,
    HANDLE_THICKNESS,
    LAST_WRITTEN,
    PLATE_THICKNESS,
    ROD_THICKNESS,
    SHAPES,
    STEM_THICKNESS,
    UPPER_HEIGHTS,
    VASE_THICKNESS,
    RenderError,
    render,
    tool_arguments,
    tool_for,
)
from benchmarks.scene_scores import facet_angle
from benchmarks.scene_sets import READY_MADE, RENDERED, SCENES, BenchmarkScene, Cameras, Kind, SceneSet, Shape

HOMER = next(scene for scene in RENDERED if scene.name == "homer_gold_hdr")
FAKE_TOOL = """
import sys
from pathlib import Path
out = Path(sys.argv[sys.argv.index("--out") + 1])
out.mkdir()
(out / "train.txt").write_text(" ".join(sys.argv))
{fault}
(out / "scene_info.json").write_text("{{}}")
"""


@pytest.fixture
def tool_source(shared_data: Path) -> str:
    return (shared_data.parent / "tools" / "render_scene.py").read_text(encoding="utf-8")


def tool_parser(source: str) -> ArgumentParser:
    """Return the renderer's own parser: what its source says before it parses."""
    before, parses, _ = source.partition("a = p.parse_args()")
    assert parses
    names: dict[str, Any] = {}
    exec(before, names)
    parser: argparse.ArgumentParser = names["p"]
    return parser


def parsed(scene: BenchmarkScene, source: str) -> SimpleNamespace:
    arguments = tool_arguments(scene, Path("mesh.obj"), Path("out"))
    return tool_parser(source).parse_args(arguments, SimpleNamespace())


def test_names_and_seeds_are_unique() -> None:
    assert len({scene.name for scene in SCENES}) == len(SCENES) == 33
    seeds = [scene.arguments.split()[scene.arguments.split().index("--seed") + 1] for scene in RENDERED]
    assert len(set(seeds)) == len(RENDERED)


@pytest.mark.parametrize("scene_set", SceneSet)
def test_each_set_has_every_kind(scene_set: SceneSet) -> None:
    assert {scene.kind for scene in SCENES if scene.set == scene_set} == set(Kind)


def test_sources_and_ready_made_scenes_lie_beside_the_checkout(shared_data: Path) -> None:
    assert all((shared_data / "scenes" / scene.name / "mesh_gt.ply").is_file() for scene in READY_MADE)
    files = [scene.source for scene in RENDERED if not isinstance(scene.source, Shape)]
    assert [file for file in files if not (shared_data / "meshes" / str(file)).is_file()] == []


@pytest.mark.parametrize("scene", RENDERED, ids=lambda scene: scene.name)
def test_the_renderer_takes_the_arguments(scene: BenchmarkScene, tool_source: str) -> None:
    taken = parsed(scene, tool_source)
    views = {"cow_flash_16": 16, "homer_cone": 32, "hand_cone_hdr": 32, "brucewick_cone": 32, "penguin_cone": 32}.get(
        scene.name, 48
    )
    samples = {"bowl_soft": 192, "cup_coat_hdr": 128, "mushroom_soft": 96, "vase_sky": 128}.get(scene.name, 64)
    assert (taken.res, taken.views, taken.test_views, taken.spp) == (256, views, 8, samples)
    lights = [word for word in scene.name.split("_") if word in ("soft", "sky", "hdr", "flash", "dark")]
    assert lights in ([], [taken.light]), "the name says another light"


@pytest.mark.parametrize(
    ("cameras", "heights"), [(Cameras.FULL, (-0.85, 0.97)), (Cameras.UPPER, (0.05, 0.95)), (Cameras.CONE, (0.7071, 1))]
)
def test_cameras_are_where_the_scene_says(cameras: Cameras, heights: tuple[float, float], tool_source: str) -> None:
    scene = BenchmarkScene("any", Kind.MATTE, SceneSet.TUNING, "any.obj", cameras=cameras)
    section = tool_for(cameras, tool_source).partition("def look(")[1:]
    functions = "".join(section).partition("c_train, c_test")[0]
    names: dict[str, Any] = {"np": np, "math": math, "a": parsed(scene, tool_source)}
    exec(functions, names)
    places = np.array([pose[:3, 3] for pose in names["cams"](200, np.random.default_rng(1))])
    z = places[:, 2] / np.linalg.norm(places, axis=1)
    assert heights[0] - 1e-6 <= z.min() < heights[0] + 0.05
    assert heights[1] - 0.05 < z.max() <= heights[1] + 1e-6


@pytest.mark.parametrize("count", [0, 2])
def test_a_renderer_with_other_cameras_is_refused(count: int) -> None:
    with pytest.raises(RenderError, match=f"got it {count} times"):
        tool_for(Cameras.CONE, UPPER_HEIGHTS * count)


def fake_shared(folder: Path, fault: str = "") -> Path:
    (folder / "tools").mkdir(parents=True)
    (folder / "tools" / "render_scene.py").write_text(FAKE_TOOL.format(fault=fault))
    return folder


def test_a_scene_is_rendered_once(tmp_path: Path) -> None:
    shared, out = fake_shared(tmp_path / "shared"), tmp_path / "out"
    assert render(HOMER, out, shared, sys.executable)
    assert {path.name for path in out.iterdir()} == {HOMER.name}
    written = (out / HOMER.name / "train.txt").read_text()
    assert f"--mesh {shared / 'data' / 'meshes' / 'homer.obj'}" in written
    assert not render(HOMER, out, shared, "no interpreter")


def test_a_renderer_that_fails_leaves_nothing(tmp_path: Path) -> None:
    shared, out = fake_shared(tmp_path / "shared", fault="sys.exit('no Mitsuba variant')"), tmp_path / "out"
    with pytest.raises(RenderError, match=r"homer_gold_hdr: expected .* got 1; --python (.|\n)*no Mitsuba variant"):
        render(HOMER, out, shared, sys.executable)
    assert list(out.iterdir()) == []


def test_an_incomplete_folder_is_not_touched(tmp_path: Path) -> None:
    (tmp_path / HOMER.name).mkdir()
    with pytest.raises(RenderError, match=f"without {LAST_WRITTEN}; remove it"):
        render(HOMER, tmp_path, tmp_path, sys.executable)
    assert (tmp_path / HOMER.name).is_dir()


@cache
def solid(shape: Shape) -> trimesh.Trimesh:
    return SHAPES[shape]()


def crossings(mesh: trimesh.Trimesh, axis: int, place: tuple[float, float]) -> np.ndarray:
    """Return where a line along an axis, at the two other coordinates, crosses the mesh.

    The result has barycentric coordinates of the mesh's triangles seen along the axis.
    """
    a, b, c = np.moveaxis(np.delete(mesh.triangles, axis, axis=2) - place, 1, 0)
    pairs = ((b, c), (c, a), (a, b))
    weights = np.stack([p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0] for p, q in pairs], axis=1)
    hit = (weights > 0).all(axis=1) | (weights < 0).all(axis=1)
    shares = weights[hit] / weights[hit].sum(axis=1, keepdims=True)
    return np.sort((shares * mesh.triangles[hit][:, :, axis]).sum(axis=1))


@pytest.mark.parametrize(
    ("shape", "handles"),
    [
        (Shape.BOWL, 0),
        (Shape.CUP, 1),
        (Shape.RACK, 9),
        (Shape.CHAIR, 9),
        (Shape.BASKET, 36),
        (Shape.LANTERN, 19),
        (Shape.MUSHROOM, 0),
        (Shape.VASE, 0),
    ],
)
def test_shapes_are_closed_and_have_their_handles(shape: Shape, handles: int) -> None:
    mesh = solid(shape)
    assert mesh.is_watertight and mesh.is_winding_consistent and mesh.volume > 0
    assert mesh.body_count == 1
    assert mesh.euler_number == 2 - 2 * handles
    assert mesh.area_faces.min() > 0


@pytest.mark.parametrize("shape", Shape)
def test_shapes_have_about_the_size_of_a_scene(shape: Shape) -> None:
    """Check that a shape's bounding sphere has about radius 1, so that thicknesses are about in units of the scene."""
    mesh = solid(shape)
    assert np.linalg.norm(mesh.vertices - mesh.bounds.mean(axis=0), axis=1).max() == pytest.approx(1, abs=0.06)


@pytest.mark.parametrize(
    ("shape", "axis", "place", "thicknesses"),
    [
        pytest.param(Shape.BOWL, 2, (0.013, 0.011), [BOWL_THICKNESS], id="bottom of the bowl"),
        pytest.param(Shape.BOWL, 0, (0.011, 0.55), [BOWL_THICKNESS] * 2, id="wall of the bowl"),
        pytest.param(Shape.CUP, 2, (0.013, 0.011), [CUP_THICKNESS], id="bottom of the cup"),
        pytest.param(Shape.CUP, 1, (0.011, 0.013), [CUP_THICKNESS] * 2, id="wall of the cup"),
        pytest.param(Shape.CUP, 1, (0.95, 0.013), [HANDLE_THICKNESS], id="handle of the cup"),
        pytest.param(Shape.RACK, 2, (0.403, 0.407), [PLATE_THICKNESS], id="base of the rack"),
        pytest.param(Shape.RACK, 0, (0.1, -0.1), [PLATE_THICKNESS] * 2, id="standing plates"),
        pytest.param(Shape.RACK, 1, (0.28, 0.013), [ROD_THICKNESS] * 2, id="an arch's rods"),
        pytest.param(Shape.CHAIR, 2, (0.013, 0.017), [PLATE_THICKNESS], id="seat of the chair"),
        pytest.param(Shape.VASE, 2, (0.013, 0.011), [VASE_THICKNESS], id="bottom of the vase"),
        pytest.param(Shape.MUSHROOM, 0, (0.013, -0.3), [STEM_THICKNESS], id="stem of the mushroom"),
    ],
)
def test_shapes_are_as_thick_as_asked(
    shape: Shape, axis: int, place: tuple[float, float], thicknesses: list[float]
) -> None:
    through = crossings(solid(shape), axis, place)
    # 4%: a rod is some cells of the grid across, and between their corners the surface is flat.
    assert np.diff(through)[::2] == pytest.approx(thicknesses, rel=0.04)


def test_the_mushroom_has_its_gills() -> None:
    """Check that a line beside the stem crosses seven gills, obliquely, and the cap before and after."""
    thicknesses = np.diff(crossings(solid(Shape.MUSHROOM), 1, (0.5, 0.25)))[::2]
    turns = np.radians(np.arange(-45, 46, 15))
    assert thicknesses[1:-1] == pytest.approx(GILL_THICKNESS / np.cos(turns), rel=0.04)
    assert (thicknesses[[0, -1]] > CAP_THICKNESS).all()


def test_the_facet_angle_lies_between_shading_normals_and_facets(tmp_path: Path) -> None:
    (tmp_path / "geom").mkdir()
    up, tilted = np.array([0.0, 0.0, 1.0]), np.array([0.0, np.sin(np.radians(8)), np.cos(np.radians(8))])
    mask = np.array([[True, True, True, False]])
    for view, tilts in enumerate(((0, 0, 0), (8, 8, 0))):
        facets = np.stack([tilted if tilt else up for tilt in (*tilts, 8)])[None].astype(np.float32)
        shading = np.broadcast_to(up, facets.shape).astype(np.float32)
        np.savez(tmp_path / "geom" / f"r_{view}.npz", normal=shading, normal_geo=facets, mask=mask)
    assert facet_angle(tmp_path) == pytest.approx((0 + 16 / 3) / 2, abs=1e-3)
