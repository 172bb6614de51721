"""Child programs that a process starts, keeps running and stops: the parts of `mgsr serve`, the workers of GPUs."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import dataclass, field
from types import FrameType

from service.contract.errors import SetupError

RESTART_PAUSE = 0.5
# A child that dies this often within a minute is not restarted.
MOST_DEATHS = 10
LOOK = 0.2


class Stop(Exception):
    """A request to stop, raised by a signal handler."""


@dataclass
class Child:
    """A program that is kept running. patience: the seconds that it gets to stop on request."""

    name: str
    command: list[str]
    environment: dict[str, str]
    patience: float
    process: subprocess.Popen[bytes] | None = None
    deaths: list[float] = field(default_factory=list)

    def start(self) -> None:
        """Start the program, tied to this process. It has its own session, so Ctrl-C reaches only this process."""
        tied = [sys.executable, "-m", "service.contract.lifeline", str(os.getpid()), *self.command]
        self.process = subprocess.Popen(tied, env=os.environ | self.environment, start_new_session=True)

    def revive(self) -> None:
        """Restart the program if it has died. Raises SetupError if it keeps dying."""
        if self.process is None or self.process.poll() is None:
            return
        now = time.monotonic()
        self.deaths = [death for death in self.deaths if now - death < 60] + [now]
        if len(self.deaths) >= MOST_DEATHS:
            raise SetupError(
                f"the {self.name} keeps ending with exit code {self.process.returncode}; its output above says why"
            )
        print(f"the {self.name} ended with exit code {self.process.returncode}; starting it again", file=sys.stderr)
        time.sleep(RESTART_PAUSE)
        self.start()

    def stop(self, at_once: bool) -> None:
        """Ask the program to stop unless `at_once`, then kill it if it still runs."""
        if self.process is None or self.process.poll() is not None:
            return
        if not at_once:
            self.process.terminate()
            with suppress(subprocess.TimeoutExpired):
                self.process.wait(self.patience)
        self.process.kill()
        self.process.wait()


def stop_on_signals() -> None:
    """Make SIGTERM and SIGINT raise Stop in the main thread."""
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, _ask_to_stop)


def keep_alive(children: list[Child]) -> None:
    """Restart any child that dies, until Stop. Raises SetupError if a child keeps dying."""
    while True:
        for child in children:
            child.revive()
        time.sleep(LOOK)


def _ask_to_stop(number: int, frame: FrameType | None) -> None:
    raise Stop
