"""The terms of a search for cameras: the folder for the result, and the callbacks for progress."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

# The file that marks a folder of found cameras.
SEARCH_STATE = "search.json"

# Receives a line for the user who waits.
Say = Callable[[str], None]
# Receives the share 0..1 of the search that is done. It may raise Cancelled, which ends the search.
Tell = Callable[[float], None]


def _ignore(_: object) -> None:
    """Ignore what is reported, for callers that want none."""


@dataclass(frozen=True)
class CameraSearch:
    """The terms of a search for cameras.

    folder: where the found cameras go, and where an interrupted search leaves its state; None: a temporary folder.
    resume: whether to use cameras or a state that are already there, if photographs and settings are the same.
    known_only: whether to use only cameras that are already in the folder, without a search.
    seed: the seed of COLMAP's random samples.
    say, tell: receive lines for the user, and the share that is done.
    """

    folder: Path | None = None
    resume: bool = False
    known_only: bool = False
    seed: int = 0
    say: Say = _ignore
    tell: Tell = _ignore

    def share(self, begin: float, end: float) -> Tell:
        """Return a callback for a part of the search, which spans the shares `begin` to `end` of the whole."""
        return lambda done: self.tell(begin + (end - begin) * done)
