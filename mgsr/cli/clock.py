"""Timing of a run's steps."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager


class StepClock:
    """Seconds spent in each step, by name, and since the start."""

    def __init__(self, begun: float | None = None) -> None:
        """Start the clock at `begun`, a value of time.perf_counter(); None is now."""
        self._begun = time.perf_counter() if begun is None else begun
        self.steps: dict[str, float] = {}

    @property
    def total(self) -> float:
        """Return the seconds since the start."""
        return time.perf_counter() - self._begun

    @contextmanager
    def step(self, name: str) -> Iterator[None]:
        """Count the block's time to a step; a step may come more than once."""
        begun = time.perf_counter()
        try:
            yield
        finally:
            self.steps[name] = self.steps.get(name, 0.0) + time.perf_counter() - begun
