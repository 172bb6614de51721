"""One worker for each card, by one command."""

from __future__ import annotations

import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

from service.contract.errors import SetupError
from tests.service.stack import ROOT, TINY_OPTIONS, Stack, kill_process
from worker import start


def cards_of(parent: int) -> dict[int, str]:
    """The card that each child of a process may use, by the child's process id."""
    found: dict[int, str] = {}
    for pid in Path(f"/proc/{parent}/task/{parent}/children").read_text().split():
        with suppress(OSError):  # it has just ended
            variables = Path(f"/proc/{pid}/environ").read_bytes().decode().split("\0")
            found |= {int(pid): value[21:] for value in variables if value.startswith("CUDA_VISIBLE_DEVICES=")}
    return found


@pytest.mark.slow
def test_a_worker_for_each_card(tmp_path: Path, tiny_archive: bytes) -> None:
    """Jobs that ask for a card wait for a worker that has one; a signal to the first process ends all."""
    with Stack(tmp_path, workers=1) as stack:
        job = stack.submitted(tiny_archive, TINY_OPTIONS | {"device": "cuda"})
        other = stack.submitted(tiny_archive, TINY_OPTIONS)
        stack.wait_for(other, "succeeded")
        assert stack.job(job)["status"] == "queued"
        command = [sys.executable, "-m", "worker.cli", "--gpus", "0,1"]
        with subprocess.Popen(command, env=stack.environment, cwd=ROOT) as workers:
            stack.wait_until_ready(3)
            stack.finished(job)
            workers.terminate()
            assert workers.wait(30) == 0
        assert stack.http.get("/readyz").json()["workers"] == 1


def test_a_cards_worker_that_dies_starts_again(tmp_path: Path) -> None:
    with Stack(tmp_path, workers=0) as stack:
        command = [sys.executable, "-m", "worker.cli", "--gpus", "0,1"]
        with subprocess.Popen(command, env=stack.environment, cwd=ROOT) as workers:
            stack.wait_until_ready(2)
            before = cards_of(workers.pid)
            assert sorted(before.values()) == ["0", "1"]
            kill_process(max(before))
            while max(before) in (now := cards_of(workers.pid)) or len(now) < 2:
                time.sleep(0.1)
            assert sorted(now.values()) == ["0", "1"] and min(before) in now
            workers.terminate()
            assert workers.wait(30) == 0


@pytest.mark.parametrize(("visible", "cards"), [(None, ["0", "1", "2"]), ("2,1", ["2", "1"]), ("GPU-5a", ["GPU-5a"])])
def test_all_cards_are_those_that_this_process_may_use(
    visible: str | None, cards: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("0000:01:00.0", "0000:02:00.0", "0000:a1:00.0"):
        (tmp_path / name).mkdir()
    monkeypatch.setattr(start, "_DRIVERS_LIST", tmp_path)
    monkeypatch.delenv("CUDA_VISIBLE_DEVICES", raising=False)
    if visible is not None:
        monkeypatch.setenv("CUDA_VISIBLE_DEVICES", visible)
    seen: list[str] = []
    monkeypatch.setattr(start, "_one_for_each", seen.extend)
    start.start_workers("all")
    assert seen == cards


@pytest.mark.parametrize("visible", [None, ""])
def test_no_card_is_told(visible: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(start, "_DRIVERS_LIST", tmp_path / "none")
    monkeypatch.delenv("CUDA_VISIBLE_DEVICES", raising=False)
    if visible is not None:
        monkeypatch.setenv("CUDA_VISIBLE_DEVICES", visible)
    with pytest.raises(SetupError, match="--gpus all: no NVIDIA driver or card"):
        start.start_workers("all")
