"""Run steps as processes, each with a limit of time, their output in the results as it comes."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import IO

from benchmarks.gpu_check.results import LOG, SUMMARY, TOLD, Results

GRACE = 5.0  # seconds that a step has after SIGTERM
LEAST = 3.0  # seconds with which no step is begun
SHOWN = 15  # last lines of a failed step's output that are shown
ENDING = [getattr(signal, name) for name in ("SIGTERM", "SIGINT", "SIGHUP") if hasattr(signal, name)]


class LeftOutError(Exception):
    """A step that need not be, or can't be, run here; the text says why."""


class CutOffError(Exception):
    """A signal that ends the whole check; code: the exit code that tells of it."""

    def __init__(self, number: int) -> None:
        super().__init__(f"cut off by {signal.Signals(number).name}")
        self.code = 128 + number


@dataclass(frozen=True)
class Place:
    """The place where a check runs.

    It has the results, work (a folder that stays on the machine for later calls), the interpreter, the device, and the
    packed scenes and wheels that were brought, as files and folders.
    """

    results: Results
    work: Path
    python: str
    device: str
    brought: tuple[Path, ...] = ()


@dataclass(frozen=True)
class Step:
    """One process of a part.

    limit: seconds after which it is ended; file: of the results, what it prints; command: its words, or LeftOutError;
    environment: what it gets beside this process's; echo: whether what it prints is shown here, too; behind: whether
    the part goes on beside it, and waits for it at its end.
    """

    name: str
    limit: float
    file: str
    command: Callable[[Place], list[str]]
    environment: Callable[[Place], Mapping[str, str]] = field(default=lambda place: {})
    echo: bool = False
    behind: bool = False


class Running:
    """A step's process, its output on its way into the results."""

    def __init__(self, step: Step, place: Place) -> None:
        self.step, self._place = step, place
        self.started_at = time.monotonic()
        self._last: deque[str] = deque(maxlen=SHOWN)
        words = step.command(place)
        markdown = step.file.endswith(".md")
        place.results.add(LOG if markdown else step.file, f"\n== {step.name}, {time.strftime('%F %T')}\n")
        self.process = subprocess.Popen(
            words,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE if markdown else subprocess.STDOUT,
            env={**os.environ, "PYTHONUNBUFFERED": "1", **step.environment(place)},
            text=True,
            errors="replace",
            process_group=0,
        )
        streams = [(self.process.stdout, step.file), (self.process.stderr, LOG)]
        self._followers = [self._follow(stream, file) for stream, file in streams if stream is not None]

    def wait(self, seconds: float) -> str | None:
        """Return what went wrong, None where nothing did, and end the process after so many seconds."""
        try:
            code = self.process.wait(max(0.0, seconds))
        except subprocess.TimeoutExpired:
            self.end()
            return f"ended after its limit of {self.seconds:.0f} s"
        self._join()
        return f"exit code {code}" if code else None

    def end(self) -> None:
        """End the process and all that it began."""
        for number in (signal.SIGTERM, signal.SIGKILL):
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self.process.pid, number)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self.process.wait(GRACE)
        self._join()

    @property
    def seconds(self) -> float:
        """Return the seconds since the process was begun."""
        return time.monotonic() - self.started_at

    @property
    def last_lines(self) -> str:
        """Return the end of what the process printed."""
        return "".join(f"    {line}" for line in self._last)

    def _follow(self, stream: IO[str], file: str) -> threading.Thread:
        follower = threading.Thread(target=self._keep, args=(stream, file), daemon=True)
        follower.start()
        return follower

    def _keep(self, stream: IO[str], file: str) -> None:
        results, mark = self._place.results, f"{self.step.name}| " if self.step.behind else ""
        for line in stream:
            self._last.append(line)
            if line.startswith(TOLD):
                say(results, f"  - {line[len(TOLD) :].rstrip()}")
            else:
                results.add(file, mark + line)
                if self.step.echo and file == self.step.file:
                    print(line, end="", flush=True)

    def _join(self) -> None:
        # A process that left the group would keep the pipe open.
        for follower in self._followers:
            follower.join(GRACE)


def run_part(steps: list[Step], place: Place, limit: float, skip: frozenset[str] = frozenset()) -> bool:
    """Run a part's steps one after the other within so many seconds, and return whether all went well.

    A step that fails does not stop the others. Raises CutOffError after a signal, once everything that runs is ended.
    """
    ends, alive, good = time.monotonic() + limit, list[Running](), True

    def finish(running: Running) -> bool:
        wrong = running.wait(min(running.step.limit - running.seconds, ends - time.monotonic()))
        alive.remove(running)
        return _report(running, place, wrong)

    try:
        with cut_off_by_signals():
            for step in steps:
                running = _begin(step, place, ends - time.monotonic(), skip)
                if isinstance(running, bool):
                    good &= running
                    continue
                alive.append(running)
                if not step.behind:
                    good &= finish(running)
            for running in alive.copy():
                good &= finish(running)
    except CutOffError as cut:
        for running in alive:
            running.end()
            _report(running, place, str(cut))
        raise
    return good


def say(results: Results, line: str) -> None:
    """Write a line into the summary, and to whoever looks on."""
    results.add(SUMMARY, f"{line}\n")
    print(line, flush=True)


@contextlib.contextmanager
def cut_off_by_signals() -> Iterator[None]:
    """Raise CutOffError within the block for signals that end a program."""

    def cut(number: int, frame: FrameType | None) -> None:
        for each in ENDING:  # nothing disturbs the ending of what runs
            signal.signal(each, signal.SIG_IGN)
        raise CutOffError(number)

    before = {number: signal.signal(number, cut) for number in ENDING}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _begin(step: Step, place: Place, left: float, skip: frozenset[str]) -> Running | bool:
    """Start a step and return it; where it is not started, return whether that counts as well."""
    if step.name in skip:
        say(place.results, f"- {step.name}: left out by SKIP")
        return True
    if left < LEAST:
        say(place.results, f"- {step.name}: LEFT OUT, the part's time is over")
        return False
    try:
        return Running(step, place)
    except LeftOutError as reason:
        say(place.results, f"- {step.name}: left out, {reason}")
        return True
    except OSError as error:
        say(place.results, f"- {step.name}: FAILED, can't be started: {error}")
        return False


def _report(running: Running, place: Place, wrong: str | None) -> bool:
    """Say how a step ended, and return whether it ended well."""
    state = "ok" if wrong is None else f"FAILED, {wrong}"
    say(place.results, f"- {running.step.name}: {state}, {running.seconds:.0f} s, {running.step.file}")
    if wrong is not None:
        print(running.last_lines, end="", flush=True)
    return wrong is None
