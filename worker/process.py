"""The worker's handle of the job process."""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from worker.job import EVENTS_FD

# The environment variables that the job process gets. Addresses and secrets of Redis and the store are left out.
_PASSED = (
    *("PATH", "HOME", "LANG", "LC_ALL", "PYTHONPATH", "PYTHONHOME", "LD_LIBRARY_PATH"),
    *("CUDA_VISIBLE_DEVICES", "CUDA_DEVICE_ORDER"),  # a number means a card only in an order
)
_PASSED_PREFIXES = (
    *("OMP_", "MKL_", "NVIDIA_", "MGSR_CPU_", "MGSR_CUDA_"),
    *("PYTORCH_ALLOC_", "PYTORCH_CUDA_", "PYTORCH_NO_CUDA_"),  # how torch takes a card's memory
)


@dataclass(frozen=True)
class Exit:
    """The end of the process: its exit code, or minus the signal, and its peak memory in bytes."""

    code: int
    peak_memory: int


class JobProcess:
    """One run of worker/job.py, in a separate process group and tied to the thread that started it.

    It is spawned as a new program, so that it inherits no thread and no CUDA state.
    """

    def __init__(self, spec: Path, scratch: Path) -> None:
        self._buffer = b""
        self._read, write = os.pipe()
        os.set_blocking(self._read, False)
        console = os.open(scratch / "console.txt", os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)
        try:
            self.pid = os.posix_spawn(
                sys.executable,
                [sys.executable, "-m", "worker.job"],
                _environment(spec, scratch),
                file_actions=[
                    (os.POSIX_SPAWN_OPEN, 0, os.devnull, os.O_RDONLY, 0),
                    (os.POSIX_SPAWN_DUP2, console, 1),
                    (os.POSIX_SPAWN_DUP2, console, 2),
                    (os.POSIX_SPAWN_DUP2, write, EVENTS_FD),
                ],
                setpgroup=0,
            )
        finally:
            os.close(write)
            os.close(console)
        self.exit: Exit | None = None
        self.peak_memory = 0

    def events(self) -> list[dict[str, Any]]:
        """Return the events that it has sent since the last call."""
        try:
            while chunk := os.read(self._read, 1 << 16):
                self._buffer += chunk
        except BlockingIOError:
            pass
        *lines, self._buffer = self._buffer.split(b"\n")
        return [json.loads(line) for line in lines if line.strip()]

    def poll(self) -> Exit | None:
        """Return how it ended, or None while it runs."""
        if self.exit is None:
            pid, status, usage = os.wait4(self.pid, os.WNOHANG)
            if pid != 0:
                peak = max(self.peak_memory, usage.ru_maxrss * 1024)
                self.exit = Exit(os.waitstatus_to_exitcode(status), peak)
        return self.exit

    def memory(self) -> int:
        """Return the bytes of memory that it uses; 0 once it is gone."""
        try:
            status = Path(f"/proc/{self.pid}/status").read_text()
        except OSError:
            return 0
        found = [line.split()[1] for line in status.splitlines() if line.startswith("VmRSS:")]
        now = int(found[0]) * 1024 if found else 0
        self.peak_memory = max(self.peak_memory, now)
        return now

    def ask_to_stop(self) -> None:
        """Ask it to write a checkpoint and end."""
        self._signal(signal.SIGTERM)

    def kill(self) -> Exit:
        """Kill it and whatever it started, and wait until they are gone."""
        self._signal(signal.SIGKILL)
        while (ended := self.poll()) is None:
            time.sleep(0.01)
        return ended

    def close(self) -> None:
        """Make sure that it is gone, and close the pipe."""
        if self.exit is None:
            self.kill()
        os.close(self._read)

    def _signal(self, number: signal.Signals) -> None:
        # Before it has been waited for, its process id can't belong to another process.
        if self.exit is None:
            os.killpg(self.pid, number)


def _environment(spec: Path, scratch: Path) -> dict[str, str]:
    passed = {name: value for name, value in os.environ.items() if name in _PASSED or name.startswith(_PASSED_PREFIXES)}
    own = {"MGSR_JOB": str(spec), "MGSR_JOB_PARENT": str(os.getpid()), "TMPDIR": str(scratch)}
    return passed | own | {"PYTHONUNBUFFERED": "1"}
