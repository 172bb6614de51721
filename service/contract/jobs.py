"""Jobs in the store. The store is authoritative: everything here survives the loss of Redis and of workers.

jobs/<id>/job.json                  the request
jobs/<id>/rounds/<r>                mark: round r was requested (round 0, the submit, has no mark; others are retries)
jobs/<id>/pinned                    mark: the job is never deleted by age
jobs/<id>/cancels/<r>               mark: round r should stop
jobs/<id>/outcomes/<r>.json         the outcome of round r; only the first write counts
jobs/<id>/attempts/<n>/start.json   the start of attempt n by a worker; the attempt's results lie beside it
jobs/<id>/attempts/0/...            for a rerun: the results that it takes from the earlier job
jobs/<id>/attempts/<n>/end          mark: attempt n ended regularly, even without an outcome

open/<id>.<r>                       mark: round r may have no outcome yet
webhooks/<id>.<r>                   mark: the owner must still be notified of the outcome of round r
owners/<owner>/<time>.<id>          each owner's jobs; the time is negated, so that the newest sort first
uploads/<id>.<upload>               archives (archives.py)
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime

from service.contract.archives import Archives
from service.contract.records import AttemptStart, JobRecord, JobStatus, Outcome, now
from service.contract.resumable import archives_on_the_way
from service.contract.store import Store

_END_OF_TIME = 10**13
# The result files and folders that a rerun takes over: found cameras, the object's masks, and its background. The
# worker puts them into the new job's results before it begins.
FOUND_CAMERAS = ("cameras/",)
FOUND_OBJECT = ("object.json", "masks/", "splats_background.ply")
TAKEN_OVER = 0  # the number of the attempt that holds them


@dataclass(frozen=True)
class JobState:
    """A job and its state according to the store. status: None while only the queue knows it."""

    record: JobRecord
    round: int
    outcome: Outcome | None
    cancelling: bool
    pinned: bool


class Jobs:
    """The jobs of one store."""

    def __init__(self, store: Store) -> None:
        self.store, self.archives = store, Archives(store)

    def create(self, record: JobRecord) -> JobRecord:
        """File a new job. Returns the job on file, which is an earlier one if the id exists."""
        # The mark is written before the record. If this process dies in between, recovery finds the job by the mark.
        self.mark_open(record.id, 0)
        if not self.store.create(_path(record.id, "job.json"), record.to_bytes()):
            existing = self.record(record.id)
            assert existing is not None
            return existing
        self.index(record)
        return record

    def record(self, job: str) -> JobRecord | None:
        """Return the job's record, or None for an unknown id."""
        data = self.store.read(_path(job, "job.json"))
        return None if data is None else JobRecord.model_validate_json(data)

    def state(self, job: str) -> JobState | None:
        """Return the job and its last round, or None for an unknown id."""
        record = self.record(job)
        if record is None:
            return None
        last = self.last_round(job)
        outcome = self.outcome(job, last)
        cancelling = outcome is None and self.cancel_asked(job, last)
        return JobState(record, last, outcome, cancelling, self.store.read(_path(job, "pinned")) is not None)

    def last_round(self, job: str) -> int:
        """Return the number of the last requested round."""
        return max((int(name) for name in self.store.names(_path(job, "rounds"))), default=0)

    def outcome(self, job: str, number: int) -> Outcome | None:
        """Return the outcome of a round, or None while it has not ended."""
        data = self.store.read(_path(job, f"outcomes/{number}.json"))
        return None if data is None else Outcome.model_validate_json(data)

    def finish(self, job: str, number: int, outcome: Outcome) -> bool:
        """Record the outcome of a round. Returns False, without a change, if the round has already ended."""
        record = self.record(job)
        if record is not None and record.options.webhook is not None:
            self.store.replace(f"webhooks/{job}.{number}", b"")  # first, so that a crash in between loses no message
        won = self.store.create(_path(job, f"outcomes/{number}.json"), outcome.to_bytes())
        self.store.delete(f"open/{job}.{number}")
        return won

    def untold_rounds(self) -> list[tuple[str, int]]:
        """Return job and round of each outcome of which a webhook must still notify the owner."""
        found = [name.partition(".") for name in self.store.names("webhooks")]
        return [(job, int(number)) for job, _, number in found]

    def mark_notified(self, job: str, number: int) -> None:
        """Record that the owner was notified of a round's end, or can't be."""
        self.store.delete(f"webhooks/{job}.{number}")

    def ask_cancel(self, job: str, number: int) -> None:
        """Record that a round should stop."""
        self.store.replace(_path(job, f"cancels/{number}"), b"")

    def cancel_asked(self, job: str, number: int) -> bool:
        """Return whether a round should stop."""
        return self.store.read(_path(job, f"cancels/{number}")) is not None

    def ask_retry(self, job: str, number: int) -> None:
        """Open round `number`. A second call has no effect."""
        self.mark_open(job, number)
        self.store.replace(_path(job, f"rounds/{number}"), b"")

    def cancel_now(self, job: str, number: int) -> bool:
        """End a round as cancelled, and return whether it was still open. No worker may be working on it."""
        return self.finish(job, number, Outcome(status=JobStatus.CANCELLED, attempt=None, finished=now()))

    def pin(self, job: str, pinned: bool) -> None:
        """Pin a job, so that its age never deletes it, or unpin it."""
        if pinned:
            self.store.replace(_path(job, "pinned"), b"")
        else:
            self.store.delete(_path(job, "pinned"))

    def begin_attempt(self, job: str, number: int, worker: str) -> int:
        """Claim the next attempt of a job for a worker, and return its number, from 1."""
        start = AttemptStart(round=number, worker=worker, started=now()).to_bytes()
        attempt = max(self.attempts(job), default=0) + 1
        while not self.store.create(attempt_path(job, attempt, "start.json"), start):
            attempt += 1
        return attempt

    def take_over(self, source: str, job: str, results: tuple[str, ...]) -> None:
        """Copy results from the newest attempt of `source` that has them.

        results: names of files, or of folders ending in /.
        """
        found = _path(source, "attempts/")
        held: dict[int, list[str]] = {}
        for name in self.store.names(found):
            number, _, result = name.partition("/")
            if any(result == each or (each.endswith("/") and result.startswith(each)) for each in results):
                held.setdefault(int(number), []).append(result)
        if held:
            newest = max(held)
            for result in held[newest]:
                self.store.copy(attempt_path(source, newest, result), attempt_path(job, TAKEN_OVER, result))

    def end_attempt(self, job: str, attempt: int) -> None:
        """Record that an attempt ended regularly without an outcome, so that it does not count as lost."""
        self.store.replace(attempt_path(job, attempt, "end"), b"")

    def attempts(self, job: str) -> dict[int, AttemptStart]:
        """Return every attempt of a job, by number."""
        folder = _path(job, "attempts")
        numbers = [int(name.split("/")[0]) for name in self.store.names(folder) if name.endswith("/start.json")]
        found = {number: self.store.read(attempt_path(job, number, "start.json")) for number in sorted(numbers)}
        return {number: AttemptStart.model_validate_json(data) for number, data in found.items() if data is not None}

    def lost_attempts(self, job: str, number: int) -> int:
        """Return the number of a round's attempts that died without a record of their end."""
        started = [attempt for attempt, start in self.attempts(job).items() if start.round == number]
        return sum(self.store.read(attempt_path(job, attempt, "end")) is None for attempt in started)

    def mark_open(self, job: str, number: int) -> None:
        """Mark a round as open."""
        self.store.replace(f"open/{job}.{number}", b"")

    def open_rounds(self) -> Iterator[tuple[str, int, float]]:
        """Yield job and round of each open mark, and its age in seconds."""
        for entry in self.store.entries("open"):
            job, _, number = entry.key.removeprefix("open/").partition(".")
            yield job, int(number), (now() - entry.modified).total_seconds()

    def open_of(self, owner: str) -> int:
        """Return the number of an owner's queued and running jobs."""
        return len({job for job, _, _ in self.open_rounds()}.intersection(self.owned(owner)))

    def index(self, record: JobRecord) -> None:
        """Enter the job in its owner's list. A second call has no effect."""
        self.store.replace(_index_path(record), b"")

    def remove(self, record: JobRecord) -> None:
        """Remove all files of a job that has ended.

        Large files are removed first, then the job itself, so that another call can complete an interrupted removal.
        The outcomes are removed last, because without them the job would count as open.
        """
        self.archives.delete(record.archive)
        self.store.delete_all(_path(record.id, "attempts"))
        for job, number in self.untold_rounds():
            if job == record.id:
                self.mark_notified(job, number)
        self.store.delete(_index_path(record))
        self.store.delete(_path(record.id, "job.json"))
        self.store.delete_all(f"jobs/{record.id}")

    def owned(self, owner: str) -> list[str]:
        """Return the ids of an owner's jobs, the newest first."""
        return [name.partition(".")[2] for name in sorted(self.store.names(f"owners/{owner}"))]

    def created_before(self, time: datetime) -> list[str]:
        """Return the ids of all jobs that were submitted before a time."""
        first = _order(time)
        names = (name.rpartition("/")[2].partition(".") for name in self.store.names("owners"))
        return [job for order, _, job in names if order > first]

    def stored_of(self, owner: str) -> int:
        """Return the bytes that an owner's jobs take: archives, results and checkpoints."""
        owned = set(self.owned(owner))
        archives = (entry for entry in self.store.entries("uploads") if _job_of_archive(entry.key) in owned)
        files = (entry for entry in self.store.entries("jobs") if entry.key.split("/")[1] in owned)
        return sum(entry.size for entry in itertools.chain(archives, files))

    def sweep_uploads(self) -> None:
        """Remove stale archives that no job names. They come from services that were killed during an upload."""
        arriving = archives_on_the_way(self.store)

        def wanted(archive: str) -> bool:
            record = self.record(_job_of_archive(archive))
            return archive in arriving or (record is not None and record.archive == archive)

        self.archives.sweep(wanted)


def attempt_path(job: str, attempt: int, name: str) -> str:
    """Return the key of an attempt's file."""
    return _path(job, f"attempts/{attempt}/{name}")


def _job_of_archive(key: str) -> str:
    return key.split("/")[1].partition(".")[0]


def _index_path(record: JobRecord) -> str:
    return f"owners/{record.owner}/{_order(record.created)}.{record.id}"


def _order(time: datetime) -> str:
    """Return a text that sorts later times first."""
    return f"{_END_OF_TIME - round(time.timestamp() * 1000):013d}"


def _path(job: str, name: str) -> str:
    return f"jobs/{job}/{name}"
