"""`scripts/gpu_check.sh` on a machine without a GPU: every step starts, and fails for no other reason than that."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks.cuda_training import SCENES
from benchmarks.gpu_check import steps
from benchmarks.gpu_check.__main__ import main
from benchmarks.gpu_check.results import FILES, Results
from benchmarks.gpu_check.runner import LeftOutError, Place
from benchmarks.packed_scenes import Packed, pack
from tests.training.ball import ball_points, ball_scene

ROOT = Path(__file__).resolve().parents[3]
SHORT = "warmup.surfel_iterations=20 warmup.gaussian_iterations=20 mutual.iterations=410 model_selection.iterations=0"
NAMES = {number: [step.name for step in steps.parts()[number]] for number in (1, 2, 3)}
# Without a GPU, and whatever the machine has installed.
WITHOUT_GPU = re.compile(
    r"no GPU: the installed torch (is built for the CPU only|sees no NVIDIA GPU or driver)|finds no usable GPU"
)


def check(part: str, folder: Path, *packed: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    variables = {**os.environ, "PYTHON": sys.executable, "WORK": str(folder.parent / "work"), **environment}
    variables.pop("PYTHONPATH", None)
    words = ["bash", str(ROOT / "scripts" / "gpu_check.sh"), part, str(folder), *map(str, packed)]
    return subprocess.run(words, env=variables, capture_output=True, text=True, timeout=600)


def only(*names: str, part: int) -> str:
    return " ".join(set(NAMES[part]) - set(names))


@pytest.fixture
def place(tmp_path: Path) -> Place:
    return Place(Results(tmp_path / "results"), tmp_path / "work", sys.executable, "cuda")


@pytest.fixture(scope="module")
def balls(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder as `scripts/gpu_pack.sh` makes it, with small balls for the scenes."""
    folder = tmp_path_factory.mktemp("packed")
    for name in SCENES:
        pack(Packed(ball_scene(size=32, train=8, test=2), ball_points(300), {}), folder / f"{name}.npz")
    return folder


def test_limits_fit_a_part() -> None:
    """Check that steps that wait for nothing else have their time even where all before take all of theirs."""
    for part in steps.parts().values():
        first = [step.limit for step in part if not step.behind][:-3]
        assert steps.PART_LIMIT <= 9 * 60 and sum(first) <= steps.PART_LIMIT
        assert all(step.file in FILES and step.limit < steps.PART_LIMIT for step in part)
    names = [name for part in NAMES.values() for name in part]
    assert len(set(names)) == len(names) - 3  # the build is in every part, and gsplat's in two


def test_every_step_needs_its_scene_or_says_what_it_lacks(place: Place) -> None:
    for part in steps.parts().values():
        for step in part:
            try:
                words = step.command(place)
            except LeftOutError as reason:
                assert ".npz was not packed" in str(reason) or "gsplat" in str(reason), step.name
            except FileNotFoundError as error:
                assert "is not installed; skip the step with SKIP" in str(error), step.name
            else:
                assert words[0] == sys.executable, step.name


def test_scenes_are_found_in_folders_and_as_files(place: Place, balls: Path) -> None:
    brought = Place(place.results, place.work, place.python, "cuda", (balls / "lego.npz",))
    assert steps.packed_scene(brought, "lego") == balls / "lego.npz"
    with pytest.raises(LeftOutError, match=r"spot_soft.npz was not packed \(scripts/gpu_pack.sh\)"):
        steps.packed_scene(brought, "spot_soft")
    assert steps.packed_scene(replace(brought, brought=(balls,)), "spot_soft") == balls / "spot_soft.npz"


def test_without_packed_scenes_the_ball_stands_in_for_the_paper_s_object(place: Place) -> None:
    named = {step.name: step for part in steps.parts().values() for step in part}
    assert all(named[name].command(place)[-1] == "ball" for name in ("nefertiti", "nefertiti-again", "profile"))


def test_arguments(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    with pytest.raises(SystemExit):
        main(["1", str(tmp_path), str(tmp_path / "nowhere.npz")])
    assert "PACKED: there is no" in capsys.readouterr().err


def test_a_part_without_a_gpu(tmp_path: Path) -> None:
    """Check that the first part's steps that ask for the GPU fail, and that a second call adds to the results."""
    skip = only("facts", "tests", part=1)
    done = check("1", tmp_path / "results", SKIP=skip)
    assert done.returncode == 1
    lines = (tmp_path / "results" / "summary.md").read_text().splitlines()
    failed = [line.split(":")[0] for line in lines if "FAILED, exit code 1" in line]
    assert failed == ["- facts", "- tests"]
    assert "  - GPU: nvidia-smi does not answer" in lines or "  - GPU: " in "\n".join(lines)
    assert WITHOUT_GPU.search((tmp_path / "results" / "tests.txt").read_text())
    check("2", tmp_path / "results", SKIP=" ".join(NAMES[2]))
    after = (tmp_path / "results" / "summary.md").read_text().splitlines()
    assert after[: len(lines)] == lines and any(line.startswith("## Part 2") for line in after)


@pytest.mark.slow
@pytest.mark.parametrize("part", [1, 2, 3])
def test_every_step_fails_singly_without_a_gpu(part: int, tmp_path: Path, balls: Path) -> None:
    done = check(str(part), tmp_path / "results", balls)
    assert done.returncode == 1
    summary = (tmp_path / "results" / "summary.md").read_text()
    states = dict(re.findall(r"^- ([\w-]+): (.*)$", summary, re.MULTILINE))
    assert set(states) == set(NAMES[part])
    text = "".join(file.read_text() for file in (tmp_path / "results").iterdir() if file.suffix != ".zip")
    for name, state in states.items():
        if name == "build" or state.startswith("left out"):
            continue
        assert state.startswith("FAILED"), name
        assert "is not installed" in state or "exit code 1" in state, name
    assert len(WITHOUT_GPU.findall(text)) == sum("exit code 1" in state for state in states.values())
    assert "Traceback" not in text


@pytest.mark.slow
def test_the_second_and_third_part_on_the_processor(tmp_path: Path, balls: Path) -> None:
    """Check that every step that needs no GPU's own features does its work."""
    folder = tmp_path / "results"
    for part in ("2", "3"):
        check(part, folder, balls, DEVICE="cpu", SETTINGS=SHORT, RUNS="2")
    good = re.findall(r"^- ([\w-]+): ok", (folder / "summary.md").read_text(), re.MULTILINE)
    trainings = ["nefertiti", "spot_soft", "bunny_flash", "nefertiti-again", "lego"]
    assert good == ["build", "benchmark", "profile", "build", *trainings]
    results = Results(folder)
    assert {row["size"] for row in results.rows("benchmark")} == {"2k/64"}
    assert results.rows("profile")[0]["torch_operations_each"] > 20
    assert results.rows("nefertiti")[0]["sha256"] == results.rows("nefertiti-again")[0]["sha256"]
    assert "the same bytes as nefertiti: " in (folder / "summary.md").read_text()
    files = list(folder.iterdir())
    assert {file.name for file in files} <= set(FILES) and all(file.stat().st_size < 16 * 2**20 for file in files)


@pytest.mark.slow
def test_a_part_that_is_cut_off_keeps_what_it_measured(tmp_path: Path, balls: Path) -> None:
    """Check that results stay when `timeout` cuts a part off in the middle of the second of two trainings."""
    folder = tmp_path / "results"
    environment = {**os.environ, "PYTHON": sys.executable, "DEVICE": "cpu", "SETTINGS": SHORT}
    environment["WORK"] = str(tmp_path / "work")
    environment["SKIP"] = only("spot_soft", "bunny_flash", part=3)
    words = ["bash", str(ROOT / "scripts" / "gpu_check.sh"), "3", str(folder), str(balls)]
    running = subprocess.Popen(words, env=environment, stdout=subprocess.DEVNULL)
    summary, ends = folder / "summary.md", time.monotonic() + 120
    while not (summary.is_file() and "spot_soft: ok" in summary.read_text()):
        assert time.monotonic() < ends
        time.sleep(0.05)
    time.sleep(0.5)
    running.send_signal(signal.SIGTERM)
    assert running.wait(60) == 128 + signal.SIGTERM
    assert "- bunny_flash: FAILED, cut off by SIGTERM" in summary.read_text()
    results = Results(folder)
    assert len(results.rows("spot_soft")) == 1 and not results.rows("bunny_flash")
    assert (folder / "splats.zip").stat().st_size > 1000 and not (folder / "splats_unfinished.zip").exists()


@pytest.mark.slow
def test_the_gpus_tests_need_none_of_the_libraries_that_a_bare_machine_lacks(tmp_path: Path) -> None:
    lacking = ("open3d", "trimesh", "OpenImageIO", "pycolmap", "redis", "rq")
    (tmp_path / "lacking.py").write_text(f"import sys\nsys.modules.update(dict.fromkeys({lacking}))\n")
    variables = os.environ | {"PYTHONPATH": os.pathsep.join([str(tmp_path), str(ROOT)])}
    words = [sys.executable, "-m", "pytest", "-p", "lacking", "-p", "no:cacheprovider", "--collect-only", "-q"]
    done = subprocess.run([*words, "tests/cuda"], cwd=ROOT, env=variables, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stdout
