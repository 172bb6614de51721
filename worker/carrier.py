"""The upload of a running job's files to the store: checkpoint, found cameras, previews, log."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from pathlib import Path

from service.contract.errors import StoreError
from service.contract.jobs import Jobs, attempt_path

PERIOD = 1.0  # seconds between two checks for changed files
LOG_PERIOD = 5.0
CANCEL_PERIOD = 5.0
# In the results: the folder of found cameras, and the file in it that lists the others.
CAMERAS = "cameras"
CAMERA_STATE = "cameras/search.json"


class Carrier:
    """A thread that uploads files when they change. A failed upload is repeated at the next check."""

    def __init__(self, jobs: Jobs, job: str, number: int, attempt: int, scratch: Path) -> None:
        self._jobs, self._job, self._number, self._attempt = jobs, job, number, attempt
        self._scratch = scratch
        self._sent: dict[Path, tuple[int, int]] = {}
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._carry, daemon=True, name="carrier")
        self._since_log = self._since_cancel = 0.0
        self.cancel_seen = False  # whether the store has a cancel, which Redis may have lost

    def start(self) -> None:
        """Start uploading."""
        self._thread.start()

    def stop(self) -> None:
        """Stop uploading. An upload in progress is completed first."""
        self._done.set()
        self._thread.join()

    def send_checkpoint(self) -> None:
        """Upload the checkpoint if it has changed. Raises StoreError."""
        self._send_linked(self._scratch / "out" / "checkpoint", "checkpoint")

    def send_cameras(self) -> None:
        """Upload the changed files of the search for cameras. Raises StoreError.

        The state file, which names the others, is read before them and uploaded after them.
        """
        out = self._scratch / "out"
        state, snapshot = out / CAMERA_STATE, self._scratch / "cameras.state"
        if not state.exists():
            return
        version = _version(state)
        snapshot.unlink(missing_ok=True)
        os.link(state, snapshot)
        for source in sorted((out / CAMERAS).rglob("*")):
            if source.is_file() and source != state and not source.name.startswith("."):
                self._send_linked(source, source.relative_to(out).as_posix())
        if self._sent.get(state) != version:
            self._send(snapshot, CAMERA_STATE, state)

    def _send_linked(self, source: Path, name: str) -> None:
        """Upload a file if it has changed, through a hard link, because the job may replace it during the upload."""
        if not self._changed(source):
            return
        linked = self._scratch / "checkpoint.sending"
        linked.unlink(missing_ok=True)
        os.link(source, linked)
        self._send(linked, name, source)

    def send_log(self) -> None:
        """Upload the log if it has changed. Raises StoreError."""
        source = self._scratch / "out" / "log.txt"
        if self._changed(source):
            self._send(source, "log.txt", source)

    def _carry(self) -> None:
        while not self._done.wait(PERIOD):
            self._since_log += PERIOD
            self._since_cancel += PERIOD
            for step in (
                self.send_checkpoint,
                self.send_cameras,
                self._send_previews,
                self._log_if_due,
                self._look_for_cancel,
            ):
                self._try(step)

    def _try(self, step: Callable[[], None]) -> None:
        try:
            step()
        except (StoreError, OSError):
            return  # the next check tries again

    def _send_previews(self) -> None:
        for path in (self._scratch / "previews").glob("[!.]*"):
            if self._changed(path):
                self._send(path, f"previews/{path.name}", path)

    def _log_if_due(self) -> None:
        if self._since_log >= LOG_PERIOD:
            self._since_log = 0.0
            self.send_log()

    def _look_for_cancel(self) -> None:
        if self._since_cancel >= CANCEL_PERIOD:
            self._since_cancel = 0.0
            self.cancel_seen = self.cancel_seen or self._jobs.cancel_asked(self._job, self._number)

    def _changed(self, path: Path) -> bool:
        return path.exists() and self._sent.get(path) != _version(path)

    def _send(self, path: Path, name: str, source: Path) -> None:
        version = _version(path)
        self._jobs.store.upload(attempt_path(self._job, self._attempt, name), path)
        self._sent[source] = version


def _version(path: Path) -> tuple[int, int]:
    found = path.stat()
    return found.st_ino, found.st_mtime_ns
