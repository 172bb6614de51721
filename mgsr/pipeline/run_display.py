"""The display of a run: a live bar on a terminal, plain lines elsewhere, and always the lines in log.txt."""

from __future__ import annotations

import time
from pathlib import Path
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, TextColumn
from rich.progress import Progress as Bar

from mgsr.pipeline.progress import Event
from mgsr.pipeline.run_log import RunLog, event_line
from mgsr.training.progress import Progress

# Seconds between two lines of training on a console that is not a terminal.
LINE_EVERY = 2.0


class RunDisplay:
    """A callback for `run_scene` that shows its events and logs them (see `RunLog`).

    Use it in a `with` block, which closes bar and log.
    """

    def __init__(self, log: Path, append: bool, console: Console | None = None) -> None:
        self._console = console or Console(stderr=False, highlight=False)
        self._log = RunLog(log, append)
        self._bar = _make_bar(self._console) if self._console.is_terminal else None
        self._task = None if self._bar is None else self._bar.add_task("starting", total=1.0, detail="")
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
        self._log.__exit__(kind, error, trace)

    def __call__(self, event: Event) -> None:
        self._log(event)
        text = event_line(event)
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


def _make_bar(console: Console) -> Bar:
    columns = (TextColumn("{task.description:8}"), BarColumn(bar_width=24), TextColumn("{task.fields[detail]}"))
    return Bar(*columns, console=console)
