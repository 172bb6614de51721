"""Shows a run as it goes: a live bar on a terminal, plain lines elsewhere, and the lines in log.txt in any case."""

from __future__ import annotations

import time
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import IO

from rich.console import Console
from rich.progress import BarColumn, TextColumn
from rich.progress import Progress as Bar

from mgsr.errors import Cancelled, MgsrError
from mgsr.pipeline.progress import Event
from mgsr.training.progress import Progress

# Seconds between two lines of training on a console that is no terminal.
LINE_EVERY = 2.0


class RunDisplay:
    """A callback for `run_scene` that shows its events. Use it in a `with` block, which closes bar and log.

    What is told while the scene is read goes to the log once it is read, or where that ends otherwise than by a
    refusal: a scene that is refused leaves no folder, and no log in the place of an earlier one.
    """

    def __init__(self, log: Path, append: bool, console: Console | None = None) -> None:
        self._console = console or Console(stderr=False, highlight=False)
        self._open = ExitStack()
        self._log: IO[str] | None = None
        self._path, self._mode = log, ("a" if append else "w")
        self._held: list[str] = []
        self._bar = _make_bar(self._console) if self._console.is_terminal else None
        self._task = None if self._bar is None else self._bar.add_task("starting", total=1.0, detail="")
        self._begun = time.monotonic()
        self._last_line = float("-inf")

    def __enter__(self) -> RunDisplay:
        if self._bar is not None:
            self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()
        if self._held and not _is_refusal(error):
            self._open_log()
        if self._log is not None and error is not None:
            self._write_log(f"{kind.__name__ if kind else 'error'}: {error}")
        self._open.close()

    def __call__(self, event: Event) -> None:
        text = event.text if event.training is None else training_line(event.training)
        if self._log is None and event.step != "load":
            self._open_log()
        self._write_log(text)
        if self._bar is not None and self._task is not None:
            self._show_on_bar(event, text)
        elif event.training is None or self._due(event.training):
            self._console.print(text, markup=False, soft_wrap=True)

    def _show_on_bar(self, event: Event, text: str) -> None:
        assert self._bar is not None and self._task is not None
        if event.training is None:
            self._console.print(text, markup=False)
            self._bar.update(self._task, description=event.step, detail="")
        else:
            self._bar.update(self._task, description="train", completed=event.training.done, detail=text)

    def _due(self, training: Progress) -> bool:
        now = time.monotonic()
        if now - self._last_line < LINE_EVERY and training.iteration != training.total:
            return False
        self._last_line = now
        return True

    def _open_log(self) -> None:
        self._path.parent.mkdir(parents=True, exist_ok=True)
        # Line by line: a run that is killed keeps its log.
        self._log = self._open.enter_context(self._path.open(self._mode, encoding="utf-8", buffering=1))
        self._log.writelines(self._held)
        self._held.clear()

    def _write_log(self, text: str) -> None:
        line = f"{time.monotonic() - self._begun:8.1f}s  {text}\n"
        if self._log is None:
            self._held.append(line)
        else:
            self._log.write(line)


def _is_refusal(error: BaseException | None) -> bool:
    return isinstance(error, MgsrError) and not isinstance(error, Cancelled)


def training_line(training: Progress) -> str:
    """Where training is, in one line."""
    parts = [f"{training.stage} {training.iteration}/{training.total}", f"loss {sum(training.losses.values()):.4f}"]
    if training.psnr is not None:
        parts.append(f"PSNR {training.psnr:.2f} dB")
    parts += [f"{count} {name}" for name, count in training.counts.items()]
    if training.done > 0.02:
        parts.append(f"{_clock(training.seconds * (1 - training.done) / training.done)} left")
    return ", ".join(parts)


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes}:{rest:02d}"


def _make_bar(console: Console) -> Bar:
    columns = (TextColumn("{task.description:8}"), BarColumn(bar_width=24), TextColumn("{task.fields[detail]}"))
    return Bar(*columns, console=console)
