"""Steps as processes: limits of time, failures that stop nothing else, and signals that lose nothing."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from benchmarks.gpu_check import runner
from benchmarks.gpu_check.results import Results
from benchmarks.gpu_check.runner import LeftOutError, Place, Step, run_part

FOREVER = "print('measured 1', flush=True); import time; time.sleep(1000)"
# Neither ends at SIGTERM, nor is the only process.
STUBBORN = """
import signal, subprocess, sys, time
signal.signal(signal.SIGTERM, signal.SIG_IGN)
child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(1000)"])
print(child.pid, flush=True)
time.sleep(1000)
"""


@pytest.fixture
def place(tmp_path: Path) -> Place:
    return Place(Results(tmp_path / "results"), tmp_path / "work", sys.executable, "cpu")


def step(name: str, program: str, limit: float = 60, **more: Any) -> Step:
    return Step(name, limit, "log.txt", lambda place: [place.python, "-c", program], **more)


def read(place: Place, file: str = "log.txt") -> str:
    return (place.results.folder / file).read_text()


def summary(place: Place) -> list[str]:
    return read(place, "summary.md").splitlines()


def waiting_for(condition: Callable[[], bool]) -> None:
    ends = time.monotonic() + 30
    while not condition():
        assert time.monotonic() < ends
        time.sleep(0.02)


def is_alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"


def test_a_failure_does_not_stop_the_others(place: Place, capsys: pytest.CaptureFixture[str]) -> None:
    steps = [step("bad", "print('before'); raise SystemExit('why')"), step("good", "print('result: a number')")]
    assert run_part(steps, place, limit=60) is False
    assert summary(place)[0].startswith("- bad: FAILED, exit code 1, ") and summary(place)[0].endswith("log.txt")
    assert summary(place)[1] == "  - a number" and summary(place)[2].startswith("- good: ok, ")
    assert "before\nwhy\n" in read(place)
    assert "    why\n" in capsys.readouterr().out  # what failed is also shown at once
    assert run_part(steps[1:], place, limit=60) is True


def test_a_step_ends_at_its_limit_and_keeps_what_it_printed(place: Place) -> None:
    started_at = time.monotonic()
    assert run_part([step("slow", FOREVER, limit=3), step("next", "pass")], place, limit=60) is False
    assert time.monotonic() - started_at < 20
    assert "measured 1\n" in read(place)
    assert "- slow: FAILED, ended after its limit of 3 s" in summary(place)[0] and "- next: ok" in summary(place)[1]


def test_the_part_ends_at_its_limit(place: Place) -> None:
    assert run_part([step("slow", FOREVER), step("late", "print('late')")], place, limit=5) is False
    assert "- slow: FAILED" in summary(place)[0]
    assert summary(place)[1] == "- late: LEFT OUT, the part's time is over" and "late" not in read(place)


def test_nothing_of_a_step_outlives_it(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runner, "GRACE", 0.5)
    run_part([step("stubborn", STUBBORN, limit=3)], place, limit=60)
    child = int(read(place).split()[-1])
    waiting_for(lambda: not is_alive(child))


def test_a_step_behind_the_others(place: Place) -> None:
    slow = step("behind", "import time; print('begun'); time.sleep(1); print('result: built')", behind=True)
    assert run_part([slow, step("front", "print('front')")], place, limit=60) is True
    assert [line.partition(",")[0] for line in summary(place)] == ["- front: ok", "  - built", "- behind: ok"]
    assert "behind| begun\n" in read(place)


def test_what_is_not_run_says_why(place: Place) -> None:
    def nothing(place: Place) -> list[str]:
        raise LeftOutError("nothing was brought")

    def missing(place: Place) -> list[str]:
        raise FileNotFoundError("ncu is not installed")

    steps = [Step("a", 9, "log.txt", nothing), Step("b", 9, "log.txt", missing), step("c", "print(1)")]
    absent = Step("d", 9, "log.txt", lambda place: ["/nowhere/program"])
    assert run_part([*steps, absent], place, limit=60, skip=frozenset({"c"})) is False
    a, b, c, d = summary(place)
    assert a == "- a: left out, nothing was brought" and c == "- c: left out by SKIP"
    assert b == "- b: FAILED, can't be started: ncu is not installed"
    assert d.startswith("- d: FAILED, can't be started: ") and "/nowhere/program" in d
    assert run_part([steps[0]], place, limit=60) is True


def test_tables_are_kept_apart_from_messages(place: Place, capsys: pytest.CaptureFixture[str]) -> None:
    program = "import sys; print('| a row |'); print('a warning', file=sys.stderr)"
    table = Step("table", 60, "benchmark.md", lambda place: [place.python, "-c", program], echo=True)
    assert run_part([table], place, limit=60)
    assert read(place, "benchmark.md") == "| a row |\n"
    assert "a warning\n" in read(place)
    assert "| a row |\n" in capsys.readouterr().out


PROGRAM = """
import sys
from pathlib import Path
from typing import Any
from benchmarks.gpu_check.results import Results
from benchmarks.gpu_check.runner import *
place = Place(Results(Path(sys.argv[1])), Path(sys.argv[1]), sys.executable, "cpu")
def step(name, **more):
    program = f"print('{name} measured', flush=True); import os, time; print(os.getpid()); time.sleep(1000)"
    return Step(name, 900, "log.txt", lambda place: [sys.executable, "-uc", program], **more)
try:
    run_part([step("behind", behind=True), step("front"), step("never")], place, 900)
except CutOffError as cut:
    sys.exit(cut.code)
"""


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_check_that_is_cut_off_loses_nothing(number: signal.Signals, tmp_path: Path) -> None:
    check = subprocess.Popen([sys.executable, "-c", PROGRAM, str(tmp_path)], stdout=subprocess.DEVNULL)
    log = tmp_path / "log.txt"
    waiting_for(lambda: log.is_file() and log.read_text().count("measured") == 2 and len(log.read_text().split()) > 9)
    check.send_signal(number)
    assert check.wait(30) == 128 + number
    text = (tmp_path / "summary.md").read_text()
    assert text.count(f"FAILED, cut off by {number.name}") == 2 and "never" not in text
    assert "front measured\n" in log.read_text() and "behind| behind measured\n" in log.read_text()
    children = [
        int(line.split()[-1])
        for line in log.read_text().splitlines()
        if line.split()[-1:][0:1] and line.split()[-1].isdigit()
    ]
    assert len(children) == 2 and not any(is_alive(child) for child in children)


def test_a_check_that_is_killed_has_kept_what_was_measured(tmp_path: Path) -> None:
    """Check that what was printed is on disk already when SIGKILL, which can't be heeded, comes."""
    check = subprocess.Popen([sys.executable, "-c", PROGRAM, str(tmp_path)], stdout=subprocess.DEVNULL)
    log = tmp_path / "log.txt"
    waiting_for(lambda: log.is_file() and log.read_text().count("measured") == 2 and len(log.read_text().split()) > 9)
    before = log.read_text()
    children = [int(word) for word in before.split() if word.isdigit()]
    check.kill()
    check.wait(30)
    assert log.read_text().startswith(before)
    for child in children:
        os.killpg(child, signal.SIGKILL)
