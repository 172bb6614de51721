"""The events by which a run reports to its caller."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from mgsr.data.scene import Scene
from mgsr.inspection.findings import Inspection
from mgsr.training.progress import Progress


@dataclass(frozen=True)
class Event:
    """One event of a run.

    step: load, cameras, check, start, plan, train, export, mesh, evaluate, model, render or report.
    text: one line for the user.
    training: the progress of training, in events of the step train.
    done: the completed share, 0..1, in events during a long step.
    inspection: the findings of the step check, in its last event.
    scene: the photographs, in that event and in the event that announces a found object, there with its masks.
    """

    step: str
    text: str
    training: Progress | None = None
    done: float | None = None
    inspection: Inspection | None = None
    scene: Scene | None = None


EventCallback = Callable[[Event], None]


def ignore(event: Event) -> None:
    """Ignore an event, for callers that want none."""
