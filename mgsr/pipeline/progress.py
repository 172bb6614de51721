"""The events by which a run reports to its caller."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from mgsr.training.progress import Progress


@dataclass(frozen=True)
class Event:
    """One event of a run.

    step: load, start, plan, train, export, mesh, evaluate, render or report; text: one line for a person; training:
    where training is, in events of the training itself; done: the share of the step that is done, 0..1, in events that
    come on the way through a long step.
    """

    step: str
    text: str
    training: Progress | None = None
    done: float | None = None


EventCallback = Callable[[Event], None]


def ignore(event: Event) -> None:
    """Ignore an event, for callers that want none."""
