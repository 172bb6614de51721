"""The trainings that `scripts/gpu_check.sh` makes on a GPU, on the CPU, and what is made of their splats at home."""

from __future__ import annotations

import json
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from benchmarks import cuda_training, packed_scenes
from benchmarks.packed_scenes import Packed, pack, unpack
from mgsr.config import make_config
from mgsr.export.environment_map import load_environment_map
from mgsr.export.ply_notes import LOW_PASS, read_number
from mgsr.export.splats import load_splats
from tests.training.ball import ball_points, ball_scene

SETTINGS = ("warmup.surfel_iterations=20", "warmup.gaussian_iterations=20", "mutual.iterations=20", "reflection=both")
CONFIG = make_config("draft", overrides=SETTINGS)
CPU = torch.device("cpu")
# What a bare machine lacks of what MGSR depends on.
LACKING = ("open3d", "OpenImageIO", "trimesh", "fast_simplification", "pillow_heif", "zstandard", "cv2", "xatlas")


def packed_ball(folder: Path) -> Packed:
    file = folder / "ball.npz"
    content = Packed(ball_scene(size=48, train=6, test=2), ball_points(800), {"flash.npz": b"found before"})
    pack(content, file)
    return unpack(file)


def test_a_packed_scene_trains_to_files(tmp_path: Path) -> None:
    out = tmp_path / "out"
    facts = cuda_training.run(packed_ball(tmp_path), out, CONFIG, CPU)
    assert json.loads((out / "training.json").read_text()) == facts
    assert facts["reflection"] == {"chosen": "both", "tried": {}}
    for name, branch in (("splats_2d.ply", "surfels"), ("splats_3d.ply", "gaussians")):
        assert len(load_splats(out / name)["means"]) == facts["splats"][branch]
        assert facts["psnr"][branch] > 10
    assert load_environment_map(out / "mirrored_light.npz").maps.shape[:2] == (2, 3)
    assert read_number(out / "splats_3d.ply", LOW_PASS) == CONFIG.train.gaussians.low_pass
    assert (out / "flash.npz").read_bytes() == b"found before"
    assert cuda_training.digests(out) == facts["sha256"]


def test_two_trainings_have_the_same_hashes_and_other_ones_not(tmp_path: Path) -> None:
    content = packed_ball(tmp_path)
    first, again = (cuda_training.run(content, tmp_path / name, CONFIG, CPU) for name in ("first", "again"))
    assert first["sha256"] == again["sha256"] and set(first["sha256"]) == set(cuda_training.LEARNT)
    other = make_config("draft", seed=1, overrides=SETTINGS)
    assert cuda_training.run(content, tmp_path / "other", other, CPU)["sha256"] != first["sha256"]


def test_a_training_that_its_deadline_ends_leaves_its_splats(tmp_path: Path) -> None:
    facts = cuda_training.run(packed_ball(tmp_path), tmp_path / "out", CONFIG, CPU, deadline=0.0)
    assert {reason for _, _, reason in facts["stages"].values()} == {"deadline"}
    assert load_splats(tmp_path / "out" / "splats_2d.ply")


def test_training_needs_none_of_what_a_bare_machine_lacks() -> None:
    block = f"import sys; sys.modules |= dict.fromkeys({LACKING})"
    modules = "train, profile_training, memory, fault, counted_kernels, compile_kernels, build_gsplat, facts"
    subprocess.run([sys.executable, "-c", f"{block}; from benchmarks.gpu_check import {modules}"], check=True)


def test_home_puts_the_gpu_beside_the_cpu(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    facts = {"scene": "spot_soft", "preset": "standard", "device": "A GPU", "seconds": 12.5}
    facts["splats"] = {"surfels": 15000, "gaussians": 16000}
    with zipfile.ZipFile(tmp_path / "splats.zip", "w") as archive:
        archive.writestr("spot_soft/training.json", json.dumps(facts))
    asked = list[list[str]]()

    def answer(words: list[str], **_: Any) -> subprocess.CompletedProcess[str]:
        asked.append(words)
        scores = {"psnr_test": 36.0, "gt": {"chamfer": 0.0015, "f_005": 0.98, "normal_error": 4.5}}
        return subprocess.CompletedProcess(words, 0, json.dumps(scores))

    monkeypatch.setattr(subprocess, "run", answer)
    lines = cuda_training.home(tmp_path, tmp_path / "home", tmp_path / "data")
    assert [words[3] for words in asked] == ["mesh", "evaluate"]
    assert all(str(tmp_path / "data" / "scenes" / "spot_soft") in words for words in asked)
    assert lines[2] == "| spot_soft | standard | A GPU | 1.5 | 0.98 | 4.5 | 36 | 15000 | 16000 | 12.5 |"
    assert len(lines) > 3 and all(line.startswith("| spot_soft | standard | CPU, ") for line in lines[3:])
    chamfer = [float(line.split("|")[4]) for line in lines[3:]]
    assert np.all((np.array(chamfer) > 1) & (np.array(chamfer) < 10))  # times 1000, as ours


@pytest.mark.slow
def test_home_makes_mesh_and_scores(tmp_path: Path, shared_data: Path) -> None:
    content = packed_scenes.read(shared_data / "scenes" / "spot_soft", make_config("draft"))
    out = tmp_path / "out"
    cuda_training.run(content, out, make_config("draft"), CPU)
    with zipfile.ZipFile(tmp_path / "splats.zip", "w") as archive:
        for file in out.iterdir():
            archive.write(file, f"spot_soft/{file.name}")
    row = cuda_training.home(tmp_path, tmp_path / "home", shared_data)[2].split("|")
    assert float(row[4]) < 2.5 and float(row[7]) > 33  # Chamfer times 1000, dB
