"""The worker's parts that need no service around them."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from threading import Thread
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mgsr.inspection.findings import Code, Finding, Inspection, Severity
from mgsr.pipeline.progress import Event
from mgsr.training.progress import Progress
from service.views import FindingView
from tests.service.stack import ROOT
from worker import reporting, scratch
from worker.attempt import folder_name, joined
from worker.process import _environment
from worker.publish import media_type
from worker.reporting import AFTER, AFTER_SECONDS, AFTER_SHARE, BEFORE, CAMERAS, CURVE_ROWS, Reporter
from worker.scratch import scratch_folder, sweep


def report(tmp_path: Path, events: Iterable[Event]) -> list[dict[str, Any]]:
    reported: list[dict[str, Any]] = []
    reporter = Reporter(
        tmp_path / "previews", lambda kind, **data: reported.append({"kind": kind, **data}), lambda event: None
    )
    for event in events:
        reporter(event)
    return reported


def training(iteration: int, total: int = 1000, **more: Any) -> Event:
    fields: dict[str, Any] = {
        "losses": {"a": 0.25, "b": 0.5},
        "counts": {"surfels": 3},
        "psnr": 20.0,
        "seconds": iteration / 100,
    }
    return Event("train", "", Progress("alone", iteration, total, done=iteration / total, **(fields | more)))


def test_a_search_for_cameras_takes_its_share_of_the_progress(tmp_path: Path) -> None:
    events = [Event("load", "reading"), Event("cameras", "features", done=0.5), Event("load", "read"), training(500)]
    reported = report(tmp_path, events)
    assert [item["step"] for item in reported] == ["load", "cameras", "load", "train"]
    places = [item["progress"] for item in reported]
    assert places == sorted(places) and places[1] == CAMERAS / 2 and places[2] > CAMERAS
    assert reported[1]["step_progress"] == 0.5 and reported[1]["step_eta_seconds"] is not None
    alone = report(tmp_path, [training(500)])[0]["progress"]
    assert places[3] == pytest.approx(CAMERAS + (1 - CAMERAS) * alone, abs=0.01)


def test_findings_of_the_check_are_passed_on(tmp_path: Path) -> None:
    finding = Finding(Code.BLURRED, Severity.WARNING, "text", 2.0, "times", "cure", ("a", "b"))
    event = Event("check", "1 warning", inspection=Inspection((finding,), (), 0.5))
    (reported,) = report(tmp_path, [event])
    assert reported["step"] == "check" and BEFORE["load"] < reported["progress"] < BEFORE["start"]
    assert reported["findings"][0]["photographs"] == ("a", "b") and json.dumps(reported)
    FindingView.model_validate(reported["findings"][0])


def test_training_as_a_person_sees_it(tmp_path: Path) -> None:
    (reported,) = report(tmp_path, [training(500)])
    assert (reported["stage"], reported["iteration"], reported["total"], reported["psnr"]) == ("alone", 500, 1000, 20.0)
    # 5 of 10 seconds of training are left, then the steps after it.
    assert reported["eta_seconds"] == 5.0 + AFTER_SECONDS + AFTER_SHARE * 10.0
    before = BEFORE["train"]
    assert abs(reported["progress"] - (before + (1 - before) * 5.0 / (5.0 + reported["eta_seconds"]))) < 1e-3
    assert reported["curve"] == [{"seconds": 5.0, "stage": "alone", "iteration": 500, "loss": 0.75, "psnr": 20.0}]


def test_many_events_are_few_lines_and_the_last_is_one_of_them(tmp_path: Path) -> None:
    reported = report(tmp_path, [training(iteration) for iteration in range(1, 1001)])
    assert len(reported) < 10 and reported[-1]["iteration"] == 1000


def test_a_long_curve_is_thinned(tmp_path: Path) -> None:
    reported = report(tmp_path, [training(100, total=100, seconds=float(i)) for i in range(5 * CURVE_ROWS)])
    curve = reported[-1]["curve"]
    assert CURVE_ROWS / 2 <= len(curve) <= CURVE_ROWS
    assert [row["seconds"] for row in curve] == sorted(row["seconds"] for row in curve)


def test_numbers_that_are_none_are_no_trouble(tmp_path: Path) -> None:
    (reported,) = report(tmp_path, [training(500, losses={"a": float("nan")}, psnr=float("inf"))])
    assert reported["losses"] == {"a": None} and reported["psnr"] is None and reported["curve"][0]["loss"] is None
    json.dumps(reported, allow_nan=False)


def test_previews_are_files_at_once(tmp_path: Path) -> None:
    picture = np.full((1000, 800, 3), 127, np.uint8)
    report(tmp_path, [training(1, previews={"render": picture})])
    assert [path.name for path in (tmp_path / "previews").iterdir()] == ["render.webp"]


def test_progress_rises_and_the_time_left_falls(tmp_path: Path) -> None:
    before = [Event(step, f"the step {step}") for step in BEFORE]
    after = [Event(step, f"the step {step}") for step in AFTER]
    # Its pace falls to a third on the way: progress waits then, and does not go back.
    paces = [training(i, total=100, seconds=i * (0.1 if i < 50 else 0.3)) for i in (5, 20, 45, 50, 60, 100)]
    reported = report(tmp_path, [*before, *paces, *after])
    shares = [entry["progress"] for entry in reported]
    assert shares == sorted(shares) and shares[-1] <= 0.99 and reported[-1]["text"] == "the step report"
    left = [entry["eta_seconds"] for entry in reported[-len(AFTER) :]]
    assert left == sorted(left, reverse=True) and left[-1] > 0


def test_a_long_step_before_training_moves_and_says_how_long_it_takes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = 100.0
    monkeypatch.setattr(reporting, "time", SimpleNamespace(monotonic=lambda: now))

    def events() -> Iterator[Event]:
        nonlocal now
        yield Event("load", "reading")
        now += 50  # counts for the step before alone
        yield Event("start", "choosing starting points")
        now += 10
        yield Event("start", "choosing starting points: 25%", done=0.25)
        now += 10
        yield Event("start", "choosing starting points: 50%", done=0.5)
        yield Event("train", "training")

    reported = report(tmp_path, events())
    assert [(entry["step_progress"], entry["step_eta_seconds"]) for entry in reported] == [
        *[(None, None)] * 2,
        *((0.25, 30.0), (0.5, 20.0)),
        (None, None),
    ]
    shares = [entry["progress"] for entry in reported]
    assert shares == sorted(set(shares)) and shares[0] == BEFORE["load"] and shares[-1] == BEFORE["train"]


@pytest.mark.parametrize("step", BEFORE)
def test_each_step_before_training_may_tell_how_far_it_is(tmp_path: Path, step: str) -> None:
    """Check progress within a step; unequal exposures make the start be found again, under their step."""
    first, halfway = report(tmp_path, [Event(step, step), Event(step, step, done=0.5)])
    assert first["progress"] <= halfway["progress"] <= max(BEFORE.values())
    assert halfway["step_progress"] == 0.5


def test_training_after_a_long_start_goes_on_where_that_ended(tmp_path: Path) -> None:
    """Check that the bar neither waits nor jumps: what came before training is a fixed share of it."""
    reported = report(tmp_path, [Event("train", "training"), *(training(i, total=100) for i in (2, 100))])
    assert BEFORE["train"] == reported[0]["progress"] < reported[1]["progress"] < reported[-1]["progress"]
    assert reported[1]["progress"] < BEFORE["train"] + 0.02


def test_curves_of_two_attempts_are_one() -> None:
    earlier = [{"seconds": float(i)} for i in range(10)]
    assert joined(earlier, [{"seconds": 4.0}, {"seconds": 8.0}]) == [*earlier[:4], {"seconds": 4.0}, {"seconds": 8.0}]
    assert joined(earlier, []) == earlier and joined([], earlier) == earlier


@pytest.mark.parametrize(("name", "kind"), [("mesh.obj", "model/obj"), ("model.glb", "model/gltf-binary")])
def test_results_have_the_type_of_their_form(name: str, kind: str) -> None:
    """Check media types, also where the machine's own list says otherwise, as Debian's does of .obj."""
    assert media_type(name) == kind


HOLDER = """
import os, sys, time
from pathlib import Path
from worker.scratch import scratch_folder
with scratch_folder(Path(sys.argv[1]), "held") as folder:
    (folder / "file").write_text("x")
    print("ready", flush=True)
    time.sleep(60)
"""


def test_scratch_of_the_living_stays_and_of_the_dead_goes(tmp_path: Path) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(tmp_path)], stdout=subprocess.PIPE, text=True, cwd=ROOT
    ) as holder:
        assert holder.stdout is not None and holder.stdout.readline() == "ready\n"
        sweep(tmp_path)
        assert len(list(tmp_path.glob("held.*/file"))) == 1
        holder.kill()
    sweep(tmp_path)
    assert not list(tmp_path.iterdir())


def test_scratch_is_gone_after_its_block(tmp_path: Path) -> None:
    with scratch_folder(tmp_path / "scratch", "job.1") as folder:
        (folder / "deep").mkdir()
        assert folder.stat().st_mode & 0o077 == 0
    assert not list((tmp_path / "scratch").iterdir())


TIED = """
import os, subprocess, sys
child = [sys.executable, "-m", "service.contract.lifeline", str(os.getpid()), "sleep", "60"]
print(subprocess.Popen(child).pid, flush=True)
sys.stdin.read()
"""


def test_scratch_that_a_dying_process_writes_into_is_removed(tmp_path: Path) -> None:
    with scratch_folder(tmp_path, "job.1") as folder:
        end = time.monotonic() + 0.3

        def write() -> None:
            number = 0
            while time.monotonic() < end:
                number += 1
                with suppress(FileNotFoundError):
                    (folder / f"{number}").touch()

        writer = Thread(target=write)
        writer.start()
    writer.join()
    assert not list(tmp_path.iterdir())


def test_scratch_that_cannot_be_removed_is_swept_later(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as failing:
        failing.setattr(scratch, "PAUSE", 0.0)
        failing.setattr(shutil, "rmtree", lambda folder, ignore_errors: None)
        with scratch_folder(tmp_path, "job.1") as folder:
            pass
        sweep(tmp_path)
        assert folder.is_dir()
    sweep(tmp_path)
    assert not list(tmp_path.iterdir())


def test_a_child_on_a_lifeline_dies_with_its_parent() -> None:
    parent = subprocess.Popen(
        [sys.executable, "-c", TIED], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=ROOT
    )
    assert parent.stdout is not None
    child = int(parent.stdout.readline())
    while b"sleep" not in Path(f"/proc/{child}/cmdline").read_bytes():
        time.sleep(0.01)
    parent.send_signal(signal.SIGKILL)
    parent.wait()
    ends = time.monotonic() + 5
    while _alive(child):
        assert time.monotonic() < ends
        time.sleep(0.01)


def _alive(pid: int) -> bool:
    try:
        return "Z" not in Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except FileNotFoundError:
        return False


def test_all_gpus_of_a_machine_without_any_are_one_message() -> None:
    """Check that the error is one message, for which CUDA is not loaded."""
    if nvidia_smi_runs():
        pytest.skip("this machine has a GPU")
    environment = os.environ | {"MGSR_REDIS_URL": "redis://127.0.0.1:1"}
    environment.pop("CUDA_VISIBLE_DEVICES", None)
    command = [sys.executable, "-m", "worker.cli", "--gpus", "all"]
    ran = subprocess.run(command, env=environment, capture_output=True, text=True, cwd=ROOT, timeout=60)
    assert ran.returncode == 2 and ran.stderr.count("\n") == 1
    assert ran.stderr.startswith("error: --gpus all: ") and "--gpus 0,1" in ran.stderr


def nvidia_smi_runs() -> bool:
    smi = shutil.which("nvidia-smi")
    return smi is not None and subprocess.run([smi, "-L"], capture_output=True).returncode == 0


def test_a_job_knows_the_settings_of_its_computing_and_no_secret(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    passed = {
        "PYTORCH_ALLOC_CONF": "expandable_segments:False",
        "PYTORCH_CUDA_ALLOC_CONF": "max_split_size_mb:64",
        "PYTORCH_NO_CUDA_MEMORY_CACHING": "1",
        "CUDA_VISIBLE_DEVICES": "MIG-1",
        "CUDA_DEVICE_ORDER": "PCI_BUS_ID",
    }
    kept_back = ("MGSR_REDIS_URL", "AWS_SECRET_ACCESS_KEY", "REDIS_PASSWORD", "PYTORCHBOT_TOKEN", "PYTORCH_TOKEN")
    for name, value in (passed | dict.fromkeys(kept_back, "secret")).items():
        monkeypatch.setenv(name, value)
    environment = _environment(tmp_path / "spec.json", tmp_path)
    assert passed.items() <= environment.items()
    assert "secret" not in environment.values()


@pytest.mark.parametrize(
    ("name", "folder"),
    [
        *((None, "capture"), ("", "capture"), ("..", "capture"), ("../../etc", "etc"), ("a b/c", "a_b_c")),
        *((".hidden", "hidden"), ("Schl\u00fcssel 2", "Schl\u00fcssel_2"), ("x" * 200, "x" * 60)),
    ],
)
def test_a_name_becomes_a_folder(name: str | None, folder: str) -> None:
    assert folder_name(name) == folder
