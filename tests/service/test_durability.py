"""Nothing gets lost: many jobs, and processes that are killed while they work."""

from __future__ import annotations

import random
import re
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import httpx
import pytest
from redis import RedisError

from service.client.api import Client
from service.contract.jobs import Jobs
from service.contract.queue import JobQueue
from service.contract.store import Store
from tests.service.stack import FINAL, LONG_OPTIONS, STOPPED, TINY_OPTIONS, Stack, kill_process

RECOVERED = 45.0
STUCK = 60.0


def send(stack: Stack, archive: Path, seed: int) -> str:
    """Submit as `mgsr submit` does: again and again while the service is away."""
    for _ in range(20):
        try:
            with Client(stack.url, None) as client:
                return str(client.submit(archive, TINY_OPTIONS | {"seed": seed})["id"])
        except httpx.HTTPError:
            time.sleep(1.0)
    raise AssertionError("the service never came back")


def successes(stack: Stack) -> list[str]:
    """Return the job of each outcome `succeeded` that any worker has filed."""
    logs = "".join(path.read_text() for path in stack.folder.glob("worker*.log"))
    assert "another attempt had finished first" not in logs
    return re.findall(r"job (\w+): succeeded", logs)


@pytest.mark.slow
def test_a_killed_worker_takes_no_job_along(tmp_path: Path, tiny_archive: bytes) -> None:
    """Check that the job process dies with its worker, and another worker goes on from the checkpoint in 45 seconds."""
    with Stack(tmp_path, workers=1, MGSR_CHECKPOINT_SECONDS="1") as stack:
        job = stack.submitted(tiny_archive, LONG_OPTIONS)
        while (stack.wait_for(job, "running", step="train")["iteration"] or 0) < 200:
            time.sleep(0.1)
        jobs = Jobs(Store(str(tmp_path / "store"), 1.0))
        while jobs.store.read(f"jobs/{job}/attempts/1/checkpoint") is None:
            time.sleep(0.1)
        (process,) = stack.job_processes()
        stack.kill("worker0")
        killed = time.time()
        stack.start("worker0")
        time.sleep(0.5)
        assert process not in stack.job_processes()
        while 2 not in jobs.attempts(job):
            assert time.time() - killed < RECOVERED, stack.logs()
            time.sleep(0.2)
        print(f"taken up again after {time.time() - killed:.1f} s")
        while (stack.job(job)["attempt"], stack.job(job)["step"]) != (2, "train"):
            time.sleep(0.1)
        assert min(row["iteration"] for row in stack.job(job)["curve"]) >= 5
        stack.http.delete(f"/jobs/{job}")
        stack.wait_for(job, "cancelled", seconds=STOPPED)
        assert len(list((tmp_path / "scratch").iterdir())) == 0, "scratch of the killed worker"


@pytest.mark.slow
def test_the_queue_may_lose_everything(tmp_path: Path, tiny_archive: bytes) -> None:
    """Check that an empty Redis loses nothing: the running job goes on, the waiting one is queued again."""
    with Stack(tmp_path, workers=1) as stack:
        running = stack.submitted(tiny_archive, LONG_OPTIONS)
        waiting = stack.submitted(tiny_archive, TINY_OPTIONS)
        stack.wait_for(running, "running", step="train")
        stack.redis.flushall()
        time.sleep(6)
        assert stack.wait_for(running, "running", step="train", seconds=10)["attempt"] == 1
        stack.http.delete(f"/jobs/{running}")
        stack.wait_for(running, "cancelled", seconds=STOPPED)
        stack.wait_for(waiting, "succeeded", seconds=60)


@pytest.mark.slow
def test_a_worker_that_is_stopped_hands_its_job_back(tmp_path: Path, tiny_archive: bytes) -> None:
    with Stack(tmp_path, workers=1) as stack:
        job = stack.submitted(tiny_archive, LONG_OPTIONS)
        stack.wait_for(job, "running", step="train")
        stack.stop("worker0")
        assert stack.wait_for(job, "queued", seconds=5)["queue_position"] == 1
        assert (tmp_path / f"store/jobs/{job}/attempts/1/checkpoint").exists()
        stack.start("worker0")
        stack.wait_for(job, "running", step="train", seconds=30)
        stack.http.delete(f"/jobs/{job}")
        stack.wait_for(job, "cancelled", seconds=STOPPED)


def test_a_worker_without_redis_ends_when_asked(tmp_path: Path) -> None:
    with Stack(tmp_path, workers=1) as stack:
        stack.kill("queue")
        time.sleep(2)
        started_at = time.monotonic()
        stack.stop("worker0")
        assert time.monotonic() - started_at < 5
        stack.stop("api")


@pytest.mark.slow
@pytest.mark.timeout(7200)
def test_two_hundred_jobs_through_two_workers(tmp_path: Path, tiny_archive: bytes) -> None:
    archive = tmp_path / "scene.zip"
    archive.write_bytes(tiny_archive)
    with Stack(tmp_path, workers=2) as stack:
        started_at = time.monotonic()
        with ThreadPoolExecutor(8) as pool:
            jobs = list(pool.map(lambda seed: send(stack, archive, seed), range(200)))
        print(f"sent in {time.monotonic() - started_at:.1f} s")
        assert len(set(jobs)) == 200
        for job in jobs:
            assert stack.wait_for(job, "succeeded", seconds=7000, every=1.0)["metrics"]["mesh"]["faces"] > 500
            assert stack.http.get(f"/jobs/{job}/mesh.ply", headers={"Range": "bytes=0-2"}).content == b"ply"
        print(f"all done in {time.monotonic() - started_at:.1f} s")
        assert sorted(successes(stack)) == sorted(jobs)
        assert stack.http.get("/jobs", params={"limit": 200}).json()["next"] is None


class Chaos(threading.Thread):
    """Kills one process after the other with signal 9, and starts it again as a supervisor would."""

    def __init__(self, stack: Stack, kills: int, seed: int) -> None:
        super().__init__(daemon=True)
        self.stack, self.count, self.random = stack, kills, random.Random(seed)
        self.kills: list[str] = []

    def run(self) -> None:
        while len(self.kills) < self.count:
            time.sleep(self.random.uniform(2.0, 7.0))
            victim = self.random.choice(["queue", "api", "worker0", "worker1", "job", "job"])
            if victim == "job":
                processes = self.stack.job_processes()
                if not processes:
                    continue
                kill_process(self.random.choice(processes))
            else:
                self.stack.kill(victim)
                time.sleep(self.random.uniform(0.1, 1.5))
                self.stack.start(victim)
            self.kills.append(victim)


class Attendance(threading.Thread):
    """Watches for jobs that have not ended, and are neither in the queue nor have a process.

    longest: the most seconds that one was so. It includes what a worker does before and after the process, and all the
    time that the queue server is away.
    """

    def __init__(self, stack: Stack, store: Jobs) -> None:
        super().__init__(daemon=True)
        self.stack, self.store = stack, store
        self.longest, self.looks = 0.0, 0
        self._alone: dict[str, float] = {}
        self._done = threading.Event()

    def run(self) -> None:
        while not self._done.wait(0.3):
            now = time.monotonic()
            # In this order: from the queue to a process, and so to its end, is the way that jobs go.
            opened = {job for job, _, _ in self.store.open_rounds()}
            alone = opened - self._waiting() - self.stack.jobs_at_work()
            self._alone = {job: self._alone.get(job, now) for job in alone}
            self.longest = max([self.longest, *(now - started_at for started_at in self._alone.values())])
            self.looks += 1

    def stop(self) -> None:
        self._done.set()
        self.join()

    def _waiting(self) -> set[str]:
        try:
            return {job for job, _ in JobQueue(self.stack.redis).waiting()}
        except RedisError:
            return set()


@pytest.mark.slow
@pytest.mark.timeout(2400)
def test_thirty_jobs_while_everything_is_killed(tmp_path: Path, tiny_archive: bytes) -> None:
    archive = tmp_path / "scene.zip"
    archive.write_bytes(tiny_archive)
    with Stack(tmp_path, workers=2, MGSR_CHECKPOINT_SECONDS="1", MGSR_MAX_ATTEMPTS="50") as stack:
        store = Jobs(Store(str(tmp_path / "store"), 1.0))
        chaos, attendance = Chaos(stack, kills=40, seed=3), Attendance(stack, store)
        chaos.start()
        attendance.start()
        with ThreadPoolExecutor(4) as pool:
            jobs = list(pool.map(lambda seed: send(stack, archive, seed), range(30)))
        chaos.join()
        quiet = time.time()
        ends = {job: wait_for_outcome(store, job) for job in jobs}
        print(f"{len(chaos.kills)} kills: { ({name: chaos.kills.count(name) for name in set(chaos.kills)}) }")
        print(f"all done {max(0.0, max(ends.values()) - quiet):.1f} s after the last kill")
        stack.wait_until_ready(2)
        assert {stack.job(job)["status"] for job in jobs} == {"succeeded"}
        assert sorted(successes(stack)) == sorted(jobs)
        attendance.stop()
        lost = sum(len(store.attempts(job)) - 1 for job in jobs)
        print(f"{lost} attempts lost; no job was alone for longer than {attendance.longest:.1f} s")
        assert attendance.looks > 20
        assert attendance.longest < STUCK
        assert not stack.job_processes()


def wait_for_outcome(store: Jobs, job: str, seconds: float = 1200.0) -> float:
    """Wait until the job has ended, and return when; it asks the store, as the API may be away."""
    ends = time.monotonic() + seconds
    while (outcome := store.outcome(job, 0)) is None:
        assert time.monotonic() < ends, f"job {job} has no outcome"
        time.sleep(0.5)
    assert outcome.status in FINAL
    return outcome.finished.timestamp()
