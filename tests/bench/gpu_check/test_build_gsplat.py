"""What a build of gsplat leaves for the benchmark beside it: a package that is only shaped like it is built here."""

from __future__ import annotations

import json
import sys
import zipfile
from pathlib import Path

import pytest
import torch

from benchmarks import rasterizers
from benchmarks.gpu_check import build_gsplat, steps
from benchmarks.gpu_check.results import Results
from benchmarks.gpu_check.runner import LeftOutError, Place, Step


@pytest.fixture
def place(tmp_path: Path) -> Place:
    with zipfile.ZipFile(tmp_path / "gsplat-1.5.3-py3-none-any.whl", "w") as archive:
        archive.writestr("gsplat/__init__.py", "")
    return Place(Results(tmp_path / "results"), tmp_path / "work", sys.executable, "cpu", (tmp_path,))


def step(name: str, part: int) -> Step:
    return next(step for step in steps.parts()[part] if step.name == name)


def test_the_benchmark_goes_beside_what_was_built(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    words = step("gsplat", 1).command(place)
    assert words[-2] == "--wheel" and words[-1].endswith("gsplat-1.5.3-py3-none-any.whl")
    benchmark, beside = step("benchmark", 2), step("benchmark-beside-gsplat", 2)
    assert "--ours" in benchmark.command(place)  # so that nothing is built in the benchmark's time
    with pytest.raises(LeftOutError, match="gsplat is missing"):
        beside.command(place)

    rendered = list[str]()
    scene = rasterizers.make_scene("1k/32", torch.device("cpu"))

    def render() -> list[torch.Tensor]:
        rendered.append("3d")
        return rasterizers.our_modes(scene)["3d"]()

    mode = {"gsplat 3d": render}
    monkeypatch.setattr(rasterizers, "gsplat_modes", lambda scene: mode)
    monkeypatch.setattr(sys, "argv", words[2:])
    monkeypatch.setattr(sys, "path", sys.path.copy())
    monkeypatch.setattr("os.environ", {})
    build_gsplat.main()
    assert rendered == ["3d"]
    built = json.loads((place.work / "gsplat.json").read_text())
    assert Path(built["PYTHONPATH"], "gsplat").is_dir() and {"MAX_JOBS", "TORCH_EXTENSIONS_DIR"} <= set(built)

    with pytest.raises(LeftOutError, match="gsplat exists"):
        step("gsplat", 2).command(place)
    assert "--ours" not in beside.command(place)
    with pytest.raises(LeftOutError, match="already included gsplat"):
        beside.command(place)
    assert "--ours" not in benchmark.command(place)
    environment = benchmark.environment(place)
    assert built["PYTHONPATH"] in environment["PYTHONPATH"].split(":")
    assert environment["TORCH_EXTENSIONS_DIR"] == built["TORCH_EXTENSIONS_DIR"]


def test_a_build_that_fails_leaves_nothing(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rasterizers, "gsplat_modes", lambda scene: {})
    monkeypatch.setattr(sys, "argv", step("gsplat", 1).command(place)[2:])
    monkeypatch.setattr(sys, "path", sys.path.copy())
    monkeypatch.setattr("os.environ", {})
    with pytest.raises(SystemExit, match="cannot be imported"):
        build_gsplat.main()
    assert not (place.work / "gsplat.json").exists()
