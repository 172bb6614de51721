"""The steps of a run: their announcement, their timing, and the checks for a stop request between them."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager

from mgsr.errors import Cancelled
from mgsr.pipeline.progress import Event, EventCallback

StopCheck = Callable[[], bool]

# Seconds between two progress events of a long step.
SELDOM = 2.0


def never() -> bool:
    """Return False; the default `should_stop` of callers that never stop a run."""
    return False


def always() -> bool:
    """Return True; the default `go_on` of callers without a time limit."""
    return True


class StepClock:
    """A clock of the seconds spent in each step, by name, and since the start."""

    def __init__(self, started_at: float | None = None) -> None:
        """started_at: what time.perf_counter() said at the start; None is now."""
        self._started_at = time.perf_counter() if started_at is None else started_at
        self.steps: dict[str, float] = {}

    @property
    def total(self) -> float:
        """Return the seconds since the start."""
        return time.perf_counter() - self._started_at

    @contextmanager
    def step(self, name: str) -> Iterator[None]:
        """Add the block's duration to a step's seconds; a step may run more than once."""
        started_at = time.perf_counter()
        try:
            yield
        finally:
            self.steps[name] = self.steps.get(name, 0.0) + time.perf_counter() - started_at


class Steps:
    """The steps of a run. Each is announced and timed. A stop request ends the run before the next step begins."""

    def __init__(self, clock: StepClock, progress: EventCallback, should_stop: StopCheck) -> None:
        self.clock = clock
        self.progress = progress
        self.should_stop = should_stop

    def __call__(self, step: str, text: str) -> AbstractContextManager[None]:
        if self.should_stop():
            raise Cancelled(f"stopped on request before the step {step}")
        self.progress(Event(step, text))
        return self.clock.step(step)

    def share(self, step: str, text: str) -> Callable[[float], None]:
        """Return a callback by which a long step reports the share of it that is done, 0..1.

        Events are sent at intervals. The callback raises Cancelled if a stop is requested.
        """
        reported_at = time.monotonic()

        def report(done: float) -> None:
            """Send the share done. Raises Cancelled if a stop is requested."""
            nonlocal reported_at
            if self.should_stop():
                raise Cancelled(f"stopped on request in the step {step}")
            if time.monotonic() - reported_at > SELDOM:
                reported_at = time.monotonic()
                self.progress(Event(step, f"{text}: {done:.0%}", done=done))

        return report
