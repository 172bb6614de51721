"""A capture without masks before a plain backdrop, from the command to the results."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from typer.testing import CliRunner

from program.worker import app as worker_app
from tests.cli.spheres import SPHERES, write_spheres
from tests.cli.test_run import SHORT, UNLIT

pytestmark = pytest.mark.usefixtures("quick_report")

FEWER = ["--set", "rough_iterations=400", "--set", "learned_masks.iterations=500"]  # enough for spheres


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Provide plain spheres, on which stereo finds little."""
    folder = write_spheres(tmp_path_factory.mktemp("capture") / "spheres", train=24)
    (folder / "mesh_gt.ply").unlink()
    return folder


def run(scene: Path, out: Path, *more: str) -> tuple[dict[str, Any], trimesh.Trimesh]:
    words = ["run", str(scene), "-o", str(out), *SHORT, *UNLIT, *FEWER, "--set", "masks=off", *more]
    result = CliRunner().invoke(worker_app, words)
    assert result.exit_code == 0, result.output
    return json.loads((out / "report.json").read_text()), trimesh.load_mesh(out / "mesh.ply")


@pytest.fixture(scope="module")
def learned(scene: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], trimesh.Trimesh]:
    """Provide the report and the mesh of a run that learns the masks."""
    return run(scene, tmp_path_factory.mktemp("runs") / "learned")


def off_by(mesh: trimesh.Trimesh) -> float:
    """Return the mean distance of a mesh's vertices to the spheres."""
    distances = [np.linalg.norm(mesh.vertices - center, axis=1) - radius for center, radius, _ in SPHERES]
    return float(np.abs(np.min(distances, axis=0)).mean())


def test_the_start_and_the_surface_keep_to_what_the_splats_cover(
    learned: tuple[dict[str, Any], trimesh.Trimesh],
) -> None:
    report, mesh = learned
    assert not report["input"]["masked"] and report["input"]["starting_points"]["source"] == "hull"
    assert report["seconds"]["learned_masks"] > 0
    assert off_by(mesh) < 0.03, "pixels are 0.05 wide there"


@pytest.mark.slow
def test_without_a_backdrop_nothing_holds_the_surface(
    scene: Path, learned: tuple[dict[str, Any], trimesh.Trimesh], tmp_path: Path
) -> None:
    """Check that stereo has little to go by where the run is told that there is no backdrop."""
    report, mesh = run(scene, tmp_path / "without", "--set", "background=white")
    assert report["input"]["starting_points"]["source"] == "stereo" and "learned_masks" not in report["seconds"]
    assert off_by(mesh) > 2 * off_by(learned[1])
