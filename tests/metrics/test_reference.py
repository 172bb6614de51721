"""The metrics against the reference program's figures, which tests/metrics/golden/make.py stored."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from mgsr.geometry.mesh import Mesh
from mgsr.metrics.image import image_metrics
from mgsr.metrics.split import mean_split, split_score
from mgsr.metrics.surface import normal_metrics, surface_metrics
from mgsr.metrics.truth import load_truth
from tests.metrics.altered import SCENE, altered_image, altered_mesh, frames, load
from tests.metrics.scenes import blender_cameras

GOLDEN = json.loads((Path(__file__).parent / "golden" / f"{SCENE}.json").read_text())


@pytest.fixture(scope="module")
def scene(shared_data: Path) -> Path:
    return shared_data / "scenes" / SCENE


def check(values: dict[str, float], names: dict[str, str], tolerance: float) -> None:
    for ours, theirs in names.items():
        assert values[ours] == pytest.approx(GOLDEN[theirs], rel=tolerance), ours


@pytest.mark.slow
def test_surface(scene: Path) -> None:
    mesh = altered_mesh(scene)
    truth = load_truth(scene, [])
    assert truth is not None
    names = {"chamfer": "chamfer", "accuracy": "acc", "completeness": "comp"}
    names |= {"f_005": "F@0.005", "f_010": "F@0.01", "f_020": "F@0.02"}
    names |= {name: name for name in ("normal_consistency", "normal_consistency_signed")}
    # The required agreement is 2%; the same samples are drawn, so what is left is the stored figures' rounding.
    check(surface_metrics(Mesh(mesh.vertices, mesh.faces), truth), names, 2e-3)


def test_normals(scene: Path) -> None:
    mesh = altered_mesh(scene)
    truth = load_truth(scene, [])
    assert truth is not None
    names = {"normal_error": "normal_mae_deg", "normal_error_median": "normal_median_deg", "mask_iou": "mask_iou"}
    names["depth_error"] = "depth_mae"
    # The reference compares with maps stored in half precision, by another ray tracer.
    check(normal_metrics(Mesh(mesh.vertices, mesh.faces), truth, blender_cameras(scene, "test")), names, 5e-3)


def test_images(scene: Path) -> None:
    views = [image_metrics(load(path), altered_image(load(path), 1.0)) for path in frames(scene)]
    means = {name: float(np.mean([view[name] for view in views])) for name in views[0]}
    check(means, {name: name for name in ("psnr", "ssim", "psnr_fg", "psnr_fg_gain")}, 1e-5)


def test_split(scene: Path) -> None:
    scores = [
        split_score(load(scene / "test_matte" / path.name), altered_image(load(path), 3.0), load(path))
        for path in frames(scene)
    ]
    score = mean_split(scores)
    check({"psnr": score.split_psnr, "photo": score.split_photo}, {"psnr": "split_psnr", "photo": "split_photo"}, 1e-5)
    assert score.split_gain == pytest.approx(GOLDEN["split_gain"], abs=1e-4)
