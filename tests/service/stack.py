"""A whole service in real processes: queue server, API and workers, reached over connections."""

from __future__ import annotations

import io
import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
import zipfile
from pathlib import Path
from typing import Any

import httpx
from redis import Redis, RedisError

from service.contract.settings import Settings
from service.contract.valkey import prepare_server

ROOT = Path(__file__).resolve().parents[2]
FINAL = ("succeeded", "failed", "cancelled")

# Some seconds of work that still ends in a mesh of thousands of faces.
TINY: dict[str, Any] = {
    "train.warmup.surfel_iterations": 30,
    "train.mutual.iterations": 2,
    "train.surfels.max_start": 600,
    "mesh.poisson_depth": 5,
    "mesh.silhouette_smoothing": None,
    "mesh.max_light_residual": None,
}
TINY_OPTIONS: dict[str, Any] = {"preset": "draft", "method": "2dgs", "settings": TINY}
# Minutes of work, for tests that stop it.
LONG_OPTIONS: dict[str, Any] = {
    "preset": "draft",
    "method": "2dgs",
    "settings": TINY | {"train.warmup.surfel_iterations": 100_000, "train.paper.stop_rule": "none"},
}
# Seconds in which a job that trains is gone after a cancel: what it is given for its checkpoint, and some to spare.
STOPPED = Settings.model_fields["stop_grace"].default + 10.0


def free_port() -> int:
    """Return a port of this machine that nobody listens at."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def zip_folder(folder: Path) -> bytes:
    """Return a folder's files as a zip."""
    held = io.BytesIO()
    with zipfile.ZipFile(held, "w") as target:
        for path in sorted(folder.rglob("*")):
            if path.is_file():
                target.write(path, path.relative_to(folder).as_posix())
    return held.getvalue()


class Stack:
    """Processes by name: queue, api, worker0, worker1, ... Use in `with`."""

    def __init__(self, folder: Path, workers: int = 1, **settings: str) -> None:
        self.folder, self.worker_names = folder, [f"worker{i}" for i in range(workers)]
        self.server = prepare_server(folder)
        self.port = free_port()
        self.url = f"http://127.0.0.1:{self.port}"
        self.processes: dict[str, subprocess.Popen[bytes]] = {}
        self.environment = os.environ | {
            "PYTHONPATH": str(ROOT),
            "OMP_NUM_THREADS": "1",
            "MGSR_HOME": str(folder),
            "MGSR_REDIS_URL": self.server.url,
            **settings,
        }
        self.http = httpx.Client(base_url=self.url, timeout=60.0)
        self.redis = Redis.from_url(self.server.url)

    def __enter__(self) -> Stack:
        for name in ("queue", "api", *self.worker_names):
            self.start(name)
        self.wait_until_ready(len(self.worker_names))
        return self

    def __exit__(self, *trouble: object) -> None:
        self.http.close()
        for name in reversed(list(self.processes)):
            self.stop(name)

    def start(self, name: str, **settings: str) -> None:
        """Start a process, optionally with settings of its own; its output goes to NAME.log."""
        commands = {
            "queue": self.server.command,
            "api": [sys.executable, "-m", "service.cli", "--port", str(self.port)],
        }
        command = commands.get(name, [sys.executable, "-m", "worker.cli"])
        environment = self.environment | settings
        with (self.folder / f"{name}.log").open("ab") as log:
            self.processes[name] = subprocess.Popen(command, env=environment, stdout=log, stderr=log, cwd=ROOT)

    def job_processes(self) -> list[int]:
        """Return the process ids of this stack's job processes, also of those whose worker is gone."""
        return list(self._job_processes())

    def jobs_at_work(self) -> set[str]:
        """Return the jobs that have a job process."""
        return set(self._job_processes().values())

    def _job_processes(self) -> dict[int, str]:
        """Return the job by process id, as the processes' own environments say."""
        mark = re.compile(re.escape(f"MGSR_JOB={self.folder}/scratch/").encode() + rb"(\w+)\.")
        found: dict[int, str] = {}
        for entry in Path("/proc").iterdir():
            try:
                if entry.name.isdigit() and (hit := mark.search((entry / "environ").read_bytes())) is not None:
                    found[int(entry.name)] = hit[1].decode()
            except OSError:
                continue  # it has just ended
        return found

    def stop(self, name: str) -> None:
        """Stop a process cleanly; kill it if it does not end."""
        process = self.processes.pop(name)
        process.terminate()
        try:
            process.wait(30)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()

    def kill(self, name: str) -> None:
        """Kill a process with signal 9."""
        process = self.processes.pop(name)
        process.kill()
        process.wait()

    def wait_until_ready(self, workers: int = 0, seconds: float = 60.0) -> None:
        """Wait until queue and API answer, and so many workers listen."""
        ends = time.monotonic() + seconds
        while time.monotonic() < ends:
            try:
                self.redis.ping()
                answer = self.http.get("/readyz")
                if answer.status_code == 200 and answer.json()["workers"] >= workers:
                    return
            except (RedisError, httpx.TransportError):
                pass
            time.sleep(0.1)
        raise AssertionError(f"not ready after {seconds} s:\n{self.logs()}")

    def logs(self) -> str:
        """Return the end of each process's log."""
        return "\n".join(f"--- {path.name}\n{path.read_text()[-3000:]}" for path in self.folder.glob("*.log"))

    def submit(self, archive: bytes, options: dict[str, Any], **headers: str) -> httpx.Response:
        """Send an archive as a browser's form would."""
        files = {"archive": ("scene.zip", archive, "application/zip")}
        return self.http.post("/jobs", files=files, data={"options": json.dumps(options)}, headers=headers)

    def submitted(self, archive: bytes, options: dict[str, Any]) -> str:
        """Submit an archive, and return the id of the accepted job."""
        answer = self.submit(archive, options)
        assert answer.status_code == 202, answer.text
        return str(answer.json()["id"])

    def job(self, job: str) -> dict[str, Any]:
        """Return a job's state."""
        answer = self.http.get(f"/jobs/{job}")
        assert answer.status_code == 200, answer.text
        found: dict[str, Any] = answer.json()
        return found

    def wait_for(
        self, job: str, *statuses: str, step: str | None = None, seconds: float = 120.0, every: float = 0.1
    ) -> dict[str, Any]:
        """Wait until the job has one of the statuses (and is at a step), and return it.

        every: seconds between two looks.
        """
        ends = time.monotonic() + seconds
        while time.monotonic() < ends:
            found = self.job(job)
            if found["status"] in statuses and (step is None or found["step"] == step):
                return found
            if found["status"] in FINAL and found["status"] not in statuses:
                raise AssertionError(f"job {job} has {found['status']}: {found['error']}\n{self.logs()}")
            time.sleep(every)
        raise AssertionError(f"job {job} is not {statuses} after {seconds} s but {self.job(job)}\n{self.logs()}")

    def finished(self, job: str, seconds: float = 180.0) -> dict[str, Any]:
        """Wait until the job has ended, well or not, and return it."""
        return self.wait_for(job, *FINAL, seconds=seconds)


def kill_process(pid: int) -> None:
    """Kill a process with signal 9, if it is still there."""
    try:
        os.kill(pid, signal.SIGKILL)
    except ProcessLookupError:
        return
