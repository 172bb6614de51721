"""The interface of a stage scheduler, which may change the lengths of stages while they run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

FINISH = "finish"  # the stage after mesh extraction


class StageLength(Protocol):
    """A stage as a scheduler sees it: its name, its completed iterations, and its planned iterations."""

    @property
    def name(self) -> str: ...

    @property
    def iteration(self) -> int: ...

    @property
    def iterations(self) -> int: ...


class StageScheduler(Protocol):
    """A stage scheduler, which is asked before every iteration."""

    def length(self, stages: Sequence[StageLength], index: int, splats: Mapping[str, int]) -> int:
        """Return the total number of iterations of the stage with this index, at least one more than it has done.

        splats: the number of splats of each branch.
        """

    def state(self) -> dict[str, Any]:
        """Return the scheduler's state for a checkpoint: plain values."""
