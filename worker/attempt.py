"""An attempt at a job: fetch its files, run it, watch it, and publish its results."""

from __future__ import annotations

import logging
import re
import shutil
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from redis import RedisError

from service.contract.errors import StoreError
from service.contract.jobs import TAKEN_OVER, Jobs, attempt_path
from service.contract.live import Live
from service.contract.records import Failure, JobRecord, JobStatus, Outcome, now
from service.contract.settings import Settings
from worker.carrier import CAMERA_STATE, CAMERAS, Carrier
from worker.job import JobResult, JobSpec
from worker.lease import LeaseKeeper
from worker.process import Exit, JobProcess
from worker.publish import findings, headline, upload_results
from worker.scratch import scratch_folder
from worker.watch import Reason, Watch

log = logging.getLogger("mgsr.worker")

TICK = 0.1
BEAT_PERIOD = 10.0
KILLED = -9
# The reasons that leave no time for a last checkpoint. Other reasons need one only in the KEEPING_STEPS.
AT_ONCE = (Reason.MEMORY, Reason.LEASE_LOST, Reason.DISK_FULL)
KEEPING_STEPS = ("train", "cameras")

# Failures after which the same archive and options fail again.
FINAL_CODES = {
    "bad_scene",
    "bad_option",
    "archive_unsupported",
    "archive_damaged",
    "archive_unsafe_member",
    "archive_too_many_members",
    "archive_too_large",
    "archive_ratio",
    "image_too_large",
}


class Interrupted(Exception):
    """The attempt ends without an outcome. lost: whether another program killed its process."""

    def __init__(self, lost: bool) -> None:
        super().__init__("interrupted")
        self.lost = lost


@dataclass(frozen=True)
class WorkerContext:
    """The worker's objects that an attempt needs.

    retrying_jobs: the jobs, through a store client that waits while the store doesn't answer.
    jobs: the jobs, through a store client that gives up soon.
    stopping: returns whether the worker should stop.
    beat: reports that the worker is alive.
    step: receives the name of each step that begins.
    """

    settings: Settings
    retrying_jobs: Jobs
    jobs: Jobs
    live: Live
    stopping: Callable[[], bool]
    beat: Callable[[], None]
    step: Callable[[str], None]


class Attempt:
    """An attempt with its number and its lease."""

    def __init__(
        self, context: WorkerContext, record: JobRecord, number: int, attempt: int, lease: LeaseKeeper
    ) -> None:
        self._context, self._record, self._number, self._attempt = context, record, number, attempt
        self._lease = lease
        self._last_beat = 0.0
        self._known: dict[str, Any] = {}
        self._earlier_curve: list[dict[str, Any]] = []

    def run(self) -> Outcome:
        """Make the attempt, and return the round's outcome.

        Raises Interrupted if it ends without an outcome, and StoreError if the store does not return.
        """
        settings = self._context.settings
        with scratch_folder(settings.scratch_folder, f"{self._record.id}.{self._attempt}") as scratch:
            deadline = min(self._record.options.deadline_seconds or settings.job_deadline, settings.job_deadline)
            self._scratch = scratch
            self._carrier = Carrier(self._context.jobs, self._record.id, self._number, self._attempt, scratch)
            self._watch = Watch(
                self._context.live,
                self._record.id,
                self._number,
                deadline,
                scratch,
                settings.min_free_disk,
                settings.job_memory,
                self._reason_outside,
            )
            self._load_earlier_curve()
            unknown = {"eta_seconds": None, "step_progress": None, "step_eta_seconds": None}
            self._progress(step="fetch", text="fetching the archive", progress=0.0, **unknown)
            return self._while_watching(self._fetch) or self._run_process() or self._publish()

    def _reason_outside(self) -> Reason | None:
        self._beat()
        if self._lease.lost:
            return Reason.LEASE_LOST
        if self._carrier.cancel_seen:
            return Reason.CANCELLED
        return Reason.SHUTDOWN if self._context.stopping() else None

    def _beat(self) -> None:
        if time.monotonic() - self._last_beat > BEAT_PERIOD:
            self._last_beat = time.monotonic()
            try:
                self._context.beat()
            except RedisError:
                return  # the next heartbeat may reach Redis

    def _while_watching(self, work: Callable[[], None]) -> Outcome | None:
        """Run slow work in a thread. If there is a reason to stop, abandon the thread and return the outcome.

        An error in the thread is raised.
        """
        trouble: list[BaseException] = []

        def guarded() -> None:
            try:
                work()
            except Exception as error:
                trouble.append(error)

        thread = threading.Thread(target=guarded, daemon=True, name="transfer")
        thread.start()
        while thread.is_alive():
            if (reason := self._watch.look()) is not None:
                return self._stopped(reason, peak=None)
            thread.join(TICK)
        if trouble:
            raise trouble[0]
        return None

    def _fetch(self) -> None:
        """Fetch the archive, and the newest checkpoint and cameras of all attempts."""
        store, job = self._context.retrying_jobs.store, self._record.id
        (self._scratch / "out").mkdir()
        self._context.retrying_jobs.archives.download(self._record.archive, self._scratch / "archive")
        self._fetch_taken_over()
        held = {entry.key for entry in store.entries(f"jobs/{job}/attempts")}
        for marker, folder in (("checkpoint", "checkpoint"), (CAMERA_STATE, CAMERAS)):
            attempts = range(self._attempt - 1, 0, -1)
            earlier = next((number for number in attempts if attempt_path(job, number, marker) in held), None)
            if earlier is not None:
                self._fetch_kept(held, attempt_path(job, earlier, folder), self._scratch / "out" / folder)

    def _fetch_kept(self, held: set[str], kept: str, target: Path) -> None:
        """Fetch a file or the files of a folder that earlier attempts kept."""
        for key in held:
            if key == kept or key.startswith(f"{kept}/"):
                place = Path(f"{target}{key.removeprefix(kept)}")
                place.parent.mkdir(parents=True, exist_ok=True)
                self._context.retrying_jobs.store.download(place, key)

    def _fetch_taken_over(self) -> None:
        """Fetch the results that a rerun takes from the earlier job."""
        store, folder = self._context.retrying_jobs.store, attempt_path(self._record.id, TAKEN_OVER, "")
        for name in store.names(folder):
            path = self._scratch / "out" / name
            path.parent.mkdir(parents=True, exist_ok=True)
            store.download(path, f"{folder}{name}")

    def _run_process(self) -> Outcome | None:
        """Run the job process to its end. Returns the outcome, or None if the results are to be published."""
        killed_before = _kernel_kills()
        process = JobProcess(self._write_spec(), self._scratch)
        self._carrier.start()
        try:
            ended = self._follow(process)
        finally:
            process.close()
            self._carrier.stop()
        reason, result = self._watch.reason, self._result()
        if result is not None and result.status == "succeeded" and reason in (None, Reason.SHUTDOWN):
            return None
        if reason is not None:
            return self._stopped(reason, ended.peak_memory)
        if result is not None and result.status == "stopped":  # by a signal of another program
            self._keep_checkpoint()
            raise Interrupted(lost=True)
        if result is None:
            return self._died(ended, out_of_memory=_kernel_kills() > killed_before)
        return self._failed(result.code, result.message, ended.peak_memory)

    def _follow(self, process: JobProcess) -> Exit:
        """Pass on the process's events until it ends or is killed."""
        asked: float | None = None
        while (ended := process.poll()) is None:
            self._pass_on(process)
            reason = self._watch.look(process.memory)
            if reason is not None and asked is None:
                asked = time.monotonic()
                log.info("job %s: stopping: %s", self._record.id, reason)
                if reason in AT_ONCE or self._known["step"] not in KEEPING_STEPS:
                    return process.kill()
                process.ask_to_stop()
            if asked is not None and time.monotonic() - asked > self._context.settings.stop_grace:
                return process.kill()
            time.sleep(TICK)
        self._pass_on(process)
        return ended

    def _pass_on(self, process: JobProcess) -> None:
        for event in process.events():
            event.pop("event")
            self._progress(**event, memory_bytes=process.peak_memory)

    def _progress(self, **change: Any) -> None:
        """Report progress to listeners. If Redis is away, the next report makes up for it."""
        if "step" in change:
            self._context.step(change["step"])
        change |= {"status": JobStatus.RUNNING}
        self._known |= change | {"round": self._number, "attempt": self._attempt}
        whole = self._known | {"curve": joined(self._earlier_curve, self._known.get("curve", []))}
        try:
            self._context.live.keep_progress(self._record.id, whole, change)
        except RedisError:
            return

    def _load_earlier_curve(self) -> None:
        """Load the curve of the attempt whose checkpoint this one continues, so that both become one."""
        try:
            self._earlier_curve = self._context.live.progress(self._record.id).get("curve", [])
        except RedisError:
            return

    def _write_spec(self) -> Path:
        settings, scratch = self._context.settings, self._scratch
        spec = JobSpec(
            options=self._record.options.model_copy(update={"webhook": None}),  # its address may be a secret
            archive=scratch / "archive",
            scene=scratch / "scene" / folder_name(self._record.options.name),
            out=scratch / "out",
            previews=scratch / "previews",
            result=scratch / "result.json",
            resume=(scratch / "out" / "checkpoint").exists() or (scratch / "out" / CAMERAS).exists(),
            checkpoint_seconds=settings.checkpoint_seconds,
            max_members=settings.max_members,
            max_unpacked=settings.max_unpacked,
            max_ratio=settings.max_ratio,
            max_pixels=settings.max_pixels,
        )
        path = scratch / "spec.json"
        path.write_text(spec.model_dump_json())
        return path

    def _result(self) -> JobResult | None:
        path = self._scratch / "result.json"
        return JobResult.model_validate_json(path.read_text()) if path.exists() else None

    def _publish(self) -> Outcome:
        """Upload the results, and wait for the store if it does not answer."""
        published: list[Outcome] = []

        def work() -> None:
            out = self._scratch / "out"
            artifacts = upload_results(self._context.retrying_jobs.store, self._record.id, self._attempt, out)
            metrics = headline(out)
            published.append(
                Outcome(
                    status=JobStatus.SUCCEEDED,
                    attempt=self._attempt,
                    finished=now(),
                    artifacts=artifacts,
                    metrics=metrics,
                    findings=findings(out),
                )
            )

        self._progress(step="publish", text="storing the results", progress=0.99)
        return self._while_watching(work) or published[0]

    def _stopped(self, reason: Reason, peak: int | None) -> Outcome:
        """Return the outcome of a round that was stopped from outside, and keep its last checkpoint for a retry.

        Raises Interrupted for a lost lease and for a shutdown.
        """
        if reason is Reason.LEASE_LOST:
            raise Interrupted(lost=False)
        self._keep_checkpoint()
        if reason is Reason.SHUTDOWN:
            raise Interrupted(lost=False)
        if reason is Reason.CANCELLED:
            return Outcome(status=JobStatus.CANCELLED, attempt=self._attempt, finished=now())
        return self._failed(reason.value, self._say(reason, peak), peak)

    def _say(self, reason: Reason, peak: int | None) -> str:
        settings = self._context.settings
        if reason is Reason.MEMORY:
            return (
                f"the job used {(peak or 0) / 2**20:.0f} MiB of memory, but the worker's limit is "
                f"{settings.job_memory / 2**20:.0f} MiB; use smaller images (data.max_side), or a larger worker"
            )
        if reason is Reason.DISK_FULL:
            free = shutil.disk_usage(self._scratch).free
            least = settings.min_free_disk
            return f"the worker's disk has {free / 2**20:.0f} MiB left, but {least / 2**20:.0f} MiB must stay free"
        limit = min(self._record.options.deadline_seconds or settings.job_deadline, settings.job_deadline)
        return f"the job exceeded its deadline of {limit:g} s; retry it to continue from its checkpoint"

    def _died(self, ended: Exit, out_of_memory: bool) -> Outcome:
        """Return the outcome of a round whose process ended without a result.

        Raises Interrupted if another program killed it.
        """
        if ended.code == KILLED and out_of_memory:
            text = f"the operating system ended the job for lack of memory, at {ended.peak_memory / 2**20:.0f} MiB"
            return self._failed("out_of_memory", text, ended.peak_memory)
        if ended.code == KILLED:
            self._keep_checkpoint()
            raise Interrupted(lost=True)
        text = f"the job process ended with exit code {ended.code}: {self._last_words()}"
        return self._failed("crashed", text, ended.peak_memory)

    def _last_words(self) -> str:
        console = self._scratch / "console.txt"
        return console.read_text(errors="replace")[-500:].strip() or "it printed nothing"

    def _failed(self, code: str, message: str, peak: int | None) -> Outcome:
        self._keep_checkpoint()
        failure = Failure(code=code, message=message, retryable=code not in FINAL_CODES, peak_memory_bytes=peak)
        return Outcome(status=JobStatus.FAILED, attempt=self._attempt, finished=now(), error=failure)

    def _keep_checkpoint(self) -> None:
        """Upload checkpoint, cameras and log, without waiting for a store that doesn't answer."""
        for send in (self._carrier.send_checkpoint, self._carrier.send_cameras, self._carrier.send_log):
            try:
                send()
            except (StoreError, OSError):
                continue  # a retry then begins from an older file


def folder_name(name: str | None) -> str:
    """Return the capture's name for its report: the job's name, with only characters that file names allow."""
    return re.sub(r"[^\w.-]+", "_", name or "").strip("._")[:60] or "capture"


def joined(earlier: list[dict[str, Any]], curve: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Join two training curves. The earlier one is cut at the training time at which the other begins."""
    begins = curve[0]["seconds"] if curve else float("inf")
    return [row for row in earlier if row["seconds"] < begins] + curve


def _kernel_kills() -> int:
    """Return the number of processes that the kernel has killed for lack of memory since boot."""
    try:
        with open("/proc/vmstat") as file:
            return next((int(line.split()[1]) for line in file if line.startswith("oom_kill ")), 0)
    except OSError:
        return 0
