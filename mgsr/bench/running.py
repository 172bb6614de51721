"""The run of one cell of the matrix in a separate process, unless its results exist already."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from mgsr.bench.cells import Cell
from mgsr.bench.machine import LoadWatch, processor_name
from mgsr.report.data import ReportData

REPORT, ASKED, MEASURED, CONSOLE = "report.json", "cell.json", "machine.json", "console.txt"
MOST_SAID = 200  # letters of a run's last line
POLL = 0.1  # seconds between looks at the process and at a request to stop


class BrokenCell(Exception):
    """A cell without figures, and why."""


class Stopped(Exception):
    """The user asked to stop: the running cell is lost, and all others are kept."""


def is_finished(cell: Cell, folder: Path, commit: str | None) -> bool:
    """Return whether the folder holds the complete results of this cell.

    They must be made with the same settings at this commit (None: at any).
    """
    try:
        asked, report = _read(folder / ASKED), _read(folder / REPORT)
        ReportData.from_json(report)
    except (OSError, ValueError, KeyError, TypeError):
        return False
    wanted = identity(cell, commit if commit is not None else asked.get("commit", ""))
    return asked == wanted and report.get("settings") == wanted["settings"]


def made_at(folder: Path) -> str:
    """Return the commit at which a finished cell was run."""
    return str(_read(folder / ASKED)["commit"])


def run_cell(cell: Cell, folder: Path, commit: str, stop: Callable[[], bool]) -> None:
    """Run a cell into `folder`, which is emptied before.

    Its lines go to console.txt, the load of the machine to machine.json. Raises BrokenCell when the run fails, Stopped
    when `stop` says so meanwhile.
    """
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    watch = LoadWatch()
    with open(folder / CONSOLE, "w", encoding="utf-8") as console:
        command = [sys.executable, "-m", "mgsr.cli.main", *cell.arguments(folder)]
        # Its own session: a Ctrl-C reaches this process alone, which then ends the run in order.
        process = subprocess.Popen(command, stdout=console, stderr=subprocess.STDOUT, start_new_session=True)
        code = _wait(process, stop)
    if code != 0 or not (folder / REPORT).is_file():
        raise BrokenCell(f"exit code {code}: {_last_line(folder / CONSOLE)}")
    load = watch.read()
    (folder / MEASURED).write_text(json.dumps({"processor": processor_name(), "others": load.others}))
    # Last: a cell that was killed half way is not taken for finished.
    (folder / ASKED).write_text(json.dumps(identity(cell, commit), indent=1))


def identity(cell: Cell, commit: str) -> dict[str, Any]:
    """Return all values that identify a run."""
    return {
        "scene": str(cell.scene.resolve()),
        "device": cell.device,
        "variant": cell.variant.name,
        "settings": cell.settings(),
        "commit": commit,
    }


def _wait(process: subprocess.Popen[bytes], stop: Callable[[], bool]) -> int:
    """Wait for the process, and return its exit code."""
    try:
        while process.poll() is None:
            if stop():
                raise Stopped
            time.sleep(POLL)
    finally:
        if process.poll() is None:
            process.terminate()
            process.wait()
    return process.returncode


def _last_line(path: Path) -> str:
    lines = [line.strip() for line in path.read_text(encoding="utf-8", errors="replace").splitlines() if line.strip()]
    return textwrap.shorten(lines[-1], MOST_SAID, placeholder=" ...") if lines else "it printed nothing"


def _read(path: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return found
