"""The training that `scripts/gpu_check.sh` makes on a card, on the CPU: packed, unpacked, trained, written."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from benchmarks import cuda_training
from mgsr.config import make_config
from mgsr.export.mirrored_light import load_mirrored_light
from mgsr.export.splats import load_splats
from tests.training.ball import ball_points, ball_scene

SETTINGS = ("warmup.surfel_iterations=20", "warmup.volume_iterations=20", "mutual.iterations=20", "reflection=both")


def test_a_packed_scene_trains_to_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene, points = ball_scene(size=48, train=6, test=2), ball_points(800)
    monkeypatch.setattr(cuda_training, "ball", lambda: (scene, points))
    packed = tmp_path / "ball.npz"
    cuda_training.pack(Path(cuda_training.BALL), packed, "draft")
    unpacked, start = cuda_training.unpack(packed)
    np.testing.assert_array_equal(start.positions, points.positions)
    assert start.shiny is points.shiny
    for view, original in zip(unpacked.train + unpacked.test, scene.train + scene.test, strict=True):
        np.testing.assert_array_equal(view.image, original.image)
        np.testing.assert_array_equal(view.camera.cam_from_world, original.camera.cam_from_world)

    out = tmp_path / "out"
    config = make_config("draft", overrides=list(SETTINGS))
    facts = cuda_training.run(packed, out, config, torch.device("cpu"), profile=0)
    assert json.loads((out / "training.json").read_text()) == facts
    assert facts["reflection"] == {"chosen": "both", "tried": {}}
    for name, branch in (("splats_2d.ply", "surfels"), ("splats_3d.ply", "volumes")):
        assert len(load_splats(out / name)["means"]) == facts["splats"][branch]
        assert facts["psnr"][branch] > 10
    assert load_mirrored_light(out / "mirrored_light.npz").shape[:2] == (2, 3)
