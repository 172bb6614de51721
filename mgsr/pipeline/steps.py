"""The steps of a run, one after the other, and where its time goes."""

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
    """Return False, for callers that will not stop a run."""
    return False


def always() -> bool:
    """Return True, for callers that have all the time there is."""
    return True


class StepClock:
    """Seconds spent in each step, by name, and since the start."""

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
        """Count the block's time to a step; a step may come more than once."""
        started_at = time.perf_counter()
        try:
            yield
        finally:
            self.steps[name] = self.steps.get(name, 0.0) + time.perf_counter() - started_at


class Steps:
    """The steps of a run: each is announced and timed; before it begins, a request to stop ends the run."""

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

        Events are sent at intervals. The callback raises Cancelled where a stop is asked for.
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
