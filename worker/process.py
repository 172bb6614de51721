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

# The environment variables for the job process. It must not get the addresses and secrets of Redis and the store.
_PASSED = (
    *("PATH", "HOME", "LANG", "LC_ALL", "PYTHONPATH", "PYTHONHOME", "LD_LIBRARY_PATH"),
    *("CUDA_VISIBLE_DEVICES", "CUDA_DEVICE_ORDER"),  # both, as a GPU's number depends on the order
)
_PASSED_PREFIXES = (
    *("OMP_", "MKL_", "NVIDIA_", "MGSR_CPU_", "MGSR_CUDA_"),
    *("PYTORCH_ALLOC_", "PYTORCH_CUDA_", "PYTORCH_NO_CUDA_"),  # the settings of torch's allocator on a GPU
)


@dataclass(frozen=True)
class Exit:
    """The end of the process: its exit code, or minus the signal, and its peak memory in bytes."""

    code: int
    peak_memory: int


class JobProcess:
    """A run of worker/job.py, in a process group of its own and tied to the thread that starts it.

    It is spawned as a new program, so that it inherits no threads and no CUDA state.
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
        """Return the events that the process has sent since the last call."""
        try:
            while chunk := os.read(self._read, 1 << 16):
                self._buffer += chunk
        except BlockingIOError:
            pass
        *lines, self._buffer = self._buffer.split(b"\n")
        return [json.loads(line) for line in lines if line.strip()]

    def poll(self) -> Exit | None:
        """Return how the process ended, or None while it runs."""
        if self.exit is None:
            pid, status, usage = os.wait4(self.pid, os.WNOHANG)
            if pid != 0:
                peak = max(self.peak_memory, usage.ru_maxrss * 1024)
                self.exit = Exit(os.waitstatus_to_exitcode(status), peak)
        return self.exit

    def memory(self) -> int:
        """Return the memory that the process uses in bytes, or 0 once it is gone."""
        try:
            status = Path(f"/proc/{self.pid}/status").read_text()
        except OSError:
            return 0
        found = [line.split()[1] for line in status.splitlines() if line.startswith("VmRSS:")]
        now = int(found[0]) * 1024 if found else 0
        self.peak_memory = max(self.peak_memory, now)
        return now

    def ask_to_stop(self) -> None:
        """Ask the process to write a checkpoint and end."""
        self._signal(signal.SIGTERM)

    def kill(self) -> Exit:
        """Kill the process and its children, and wait until they are gone."""
        self._signal(signal.SIGKILL)
        while (ended := self.poll()) is None:
            time.sleep(0.01)
        return ended

    def close(self) -> None:
        """Make sure that the process is gone, and close the pipe."""
        if self.exit is None:
            self.kill()
        os.close(self._read)

    def _signal(self, number: signal.Signals) -> None:
        # Until the process has been waited for, its id can't belong to another process.
        if self.exit is None:
            os.killpg(self.pid, number)


def _environment(spec: Path, scratch: Path) -> dict[str, str]:
    passed = {name: value for name, value in os.environ.items() if name in _PASSED or name.startswith(_PASSED_PREFIXES)}
    own = {"MGSR_JOB": str(spec), "MGSR_JOB_PARENT": str(os.getpid()), "TMPDIR": str(scratch)}
    return passed | own | {"PYTHONUNBUFFERED": "1"}
