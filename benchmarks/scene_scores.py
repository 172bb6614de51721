"""Scores of the benchmark's scenes, of both sets.

    python -m benchmarks.scene_scores RENDERED -o benchmarks/results/sets.csv --runs FOLDER [--scenes NAME ...]

RENDERED: what `python -m benchmarks.render_scenes` made; the ready-made scenes lie in ../shared/data/scenes. Runs are
kept in FOLDER and those that are finished there are not repeated. Rows of other scenes and seeds stay in the file.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from benchmarks.evidence.masks import MaskRow
from benchmarks.evidence.scene_sets import SetRow
from benchmarks.evidence.surface_parts import PartRow
from benchmarks.render_scenes import SHARED
from benchmarks.scene_sets import SCENES, BenchmarkScene
from mgsr.bench.csv_rows import read_csv, write_csv
from mgsr.bench.machine import program_commit
from mgsr.config import make_config
from mgsr.config.expert import StartConfig
from mgsr.data.hull import carve, hull_surface
from mgsr.data.readers import load_scene
from mgsr.data.scene import Scene
from mgsr.data.silhouettes import view_silhouettes
from mgsr.geometry.mesh import Mesh
from mgsr.geometry.triangles import unit_vectors
from mgsr.geometry.vectors import dots
from mgsr.mesh.surface import ReconstructedMesh
from mgsr.metrics.surface import surface_metrics
from mgsr.metrics.truth import TrueSurface
from mgsr.pipeline.evaluation import find_truth, surface_scores
from mgsr.pipeline.run import run_scene

SceneRow = TypeVar("SceneRow", SetRow, PartRow, MaskRow)


def main() -> None:
    given = arguments()
    for scene in SCENES:
        if given.scenes and scene.name not in given.scenes:
            continue
        row = replace(measured(scene, find(scene, given.rendered), given), commit=given.commit or program_commit())
        replace_rows(given.out, SetRow, [row], ("scene", "seed"))


def replace_rows(out: Path, kind: type[SceneRow], found: list[SceneRow], names: Sequence[str] = ("scene",)) -> None:
    """Print rows and write them to the file, in place of those that have the same values of the named fields."""
    print(*found, sep="\n", flush=True)
    keys = [[getattr(row, name) for name in names] for row in found]
    others = [row for row in read_csv(out, kind) if [getattr(row, name) for name in names] not in keys]
    write_csv(out, kind, others + found, digits=5)


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rendered", type=Path)
    parser.add_argument("-o", dest="out", type=Path, required=True)
    parser.add_argument("--runs", type=Path, required=True)
    parser.add_argument("--scenes", nargs="*", default=[])
    parser.add_argument("--preset", default="standard")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--commit", help="the commit of the program that made the finished runs")
    return parser.parse_args()


def find(scene: BenchmarkScene, rendered: Path) -> Path:
    """Return the scene's folder."""
    return SHARED / "data" / "scenes" / scene.name if scene.source is None else rendered / scene.name


def measured(scene: BenchmarkScene, path: Path, given: argparse.Namespace) -> SetRow:
    """Return the scores of a run, of the hull and of the truth, without the commit; the run is made unless it is there.

    The runs of further seeds lie beside the first's, in SCENE_SEED.
    """
    out: Path = given.runs / (scene.name if given.seed == 0 else f"{scene.name}_{given.seed}")
    if not (out / "report.json").is_file():
        run_scene(path, out, make_config(given.preset, overrides=[f"seed={given.seed}"]))
    report = json.loads((out / "report.json").read_text())
    hull, floor = reference_scores(path)
    return SetRow(
        scene=scene.name,
        set=scene.set.value,
        kind=scene.kind.value,
        chamfer=1000 * report["gt"]["chamfer"],
        normal_error=report["gt"]["normal_error"],
        hull_chamfer=1000 * hull["chamfer"],
        hull_normal_error=hull["normal_error"],
        floor_chamfer=1000 * floor["chamfer"],
        facet_angle=facet_angle(path),
        psnr=report["psnr_test"],
        preset=report["preset"],
        seed=report["seed"],
        commit="",
    )


def reference_scores(path: Path) -> tuple[dict[str, float], dict[str, float]]:
    """Return the scores of the visual hull of a scene's masks, and of its true surface, against the truth."""
    scene = load_scene(path, make_config("standard").data)
    truth, options = find_truth(scene), StartConfig()
    hull = carve(view_silhouettes(scene.train, options.mask_side), np.zeros(3), 1.05, options.resolution)
    floor = {} if truth is None else surface_metrics(truth.mesh, truth)
    return scores_of(Mesh(*hull_surface(hull)), scene, truth), floor


def facet_angle(path: Path) -> float:
    """Return the mean angle, in degrees, between the shading normals and the facets of a scene's true mesh.

    It is the mean over the test views of the mean over their pixels, like the normal error of a run. path: the scene's
    folder, in which the renderer left both normals of each pixel (`geom`).
    """
    angles = []
    for file in sorted((path / "geom").glob("*.npz")):
        seen = np.load(file)
        shaded, facet = (unit_vectors(seen[name][seen["mask"]].astype(float)) for name in ("normal", "normal_geo"))
        angles.append(np.degrees(np.arccos(np.clip(dots(shaded, facet), -1, 1))).mean())
    return float(np.mean(angles))


def scores_of(mesh: Mesh, scene: Scene, truth: TrueSurface | None) -> dict[str, float]:
    """Return the scores of a mesh in the scene's frame against the truth."""
    placed = scene.user_from_scene.to_user(mesh.vertices)
    grey = ReconstructedMesh(placed, mesh.faces, np.zeros_like(placed, np.float32))
    return surface_scores(grey, truth, scene) or {}


if __name__ == "__main__":
    main()
