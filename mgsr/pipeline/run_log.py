"""The log of a run, log.txt."""

from __future__ import annotations

import time
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import IO

from mgsr.errors import Cancelled, MgsrError
from mgsr.pipeline.progress import Event
from mgsr.training.progress import Progress


class RunLog:
    """A log that writes the events of a run to a file. Use it in a `with` block, which closes the file.

    Events from the reading of the scene are held back until the reading ends. If the scene is refused, no folder and
    no log are written, and an earlier log remains. Any other end writes the events.
    """

    def __init__(self, path: Path, append: bool) -> None:
        """Prepare the log. append: whether to append to an earlier run's log instead of replacing it."""
        self._open = ExitStack()
        self._log: IO[str] | None = None
        self._path, self._mode = path, ("a" if append else "w")
        self._held: list[str] = []
        self._started_at = time.monotonic()

    def __enter__(self) -> RunLog:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._held and not _is_refusal(error):
            self._open_log()
        if self._log is not None and error is not None:
            self._write(f"{kind.__name__ if kind else 'error'}: {error}")
        self._open.close()

    def __call__(self, event: Event) -> None:
        if self._log is None and event.step != "load":
            self._open_log()
        self._write(event_line(event))

    def _open_log(self) -> None:
        self._path.parent.mkdir(parents=True, exist_ok=True)
        # Line buffering keeps the log of a run that is killed.
        self._log = self._open.enter_context(self._path.open(self._mode, encoding="utf-8", buffering=1))
        self._log.writelines(self._held)
        self._held.clear()

    def _write(self, text: str) -> None:
        line = f"{time.monotonic() - self._started_at:8.1f}s  {text}\n"
        if self._log is None:
            self._held.append(line)
        else:
            self._log.write(line)


def event_line(event: Event) -> str:
    """Return an event in one line."""
    return event.text if event.training is None else training_line(event.training)


def training_line(training: Progress) -> str:
    """Return the progress of training in one line."""
    parts = [f"{training.stage} {training.iteration}/{training.total}", f"loss {sum(training.losses.values()):.4f}"]
    if training.psnr is not None:
        parts.append(f"PSNR {training.psnr:.2f} dB")
    parts += [f"{count} {name}" for name, count in training.counts.items()]
    if training.done > 0.02:
        parts.append(f"{_clock(training.seconds * (1 - training.done) / training.done)} left")
    return ", ".join(parts)


def _is_refusal(error: BaseException | None) -> bool:
    return isinstance(error, MgsrError) and not isinstance(error, Cancelled)


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes}:{rest:02d}"
