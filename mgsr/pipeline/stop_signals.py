"""Handling of signals: Ctrl-C and SIGTERM as a wish to stop, and signals as an ordinary end.

The work heeds the wish between two iterations.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

INTERRUPTED = 130

# Windows has no SIGHUP.
_ENDING = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]


class StopWish:
    """The wish of the person, or the system, that the work stop; false until it is asked for."""

    def __init__(self) -> None:
        self.asked = False

    def __call__(self) -> bool:
        return self.asked


@contextmanager
def stop_on_signals() -> Iterator[StopWish]:
    """Yield a wish to stop, which the first SIGINT or SIGTERM inside sets.

    A second one stops at once (KeyboardInterrupt).
    """
    wish = StopWish()

    def ask(number: int, frame: FrameType | None) -> None:
        if wish.asked:
            raise KeyboardInterrupt
        wish.asked = True

    before = {number: signal.signal(number, ask) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield wish
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def cleaned_up_after_signals() -> Iterator[None]:
    """Let SIGTERM and SIGHUP inside end the program as SystemExit does, so that temporary files go.

    The exit code is the shell's for them; by themselves they would leave temporary files. A signal that is ignored
    (nohup) stays so, and in other threads than the main one, which alone may do this, nothing changes.
    """

    def end(number: int, frame: FrameType | None) -> None:
        raise SystemExit(128 + number)

    main = threading.current_thread() is threading.main_thread()
    taken = [number for number in _ENDING if main and signal.getsignal(number) is signal.SIG_DFL]
    for number in taken:
        signal.signal(number, end)
    try:
        yield
    finally:
        for number in taken:
            signal.signal(number, signal.SIG_DFL)
