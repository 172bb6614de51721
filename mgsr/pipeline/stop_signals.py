"""Signal handling: Ctrl-C and SIGTERM as a stop request, and signals as an ordinary exit.

A run checks for the request between two iterations.
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


class StopFlag:
    """A request of the user or the system to stop the work; it is false until the request arrives."""

    def __init__(self) -> None:
        self.asked = False

    def __call__(self) -> bool:
        return self.asked


@contextmanager
def stop_on_signals() -> Iterator[StopFlag]:
    """Yield a stop request, which the first SIGINT or SIGTERM inside the block sets.

    A second signal stops at once (KeyboardInterrupt).
    """
    flag = StopFlag()

    def ask(number: int, frame: FrameType | None) -> None:
        """Request a stop. Raises KeyboardInterrupt the second time."""
        if flag.asked:
            raise KeyboardInterrupt
        flag.asked = True

    before = {number: signal.signal(number, ask) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield flag
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def cleaned_up_after_signals() -> Iterator[None]:
    """Turn SIGTERM and SIGHUP inside the block into SystemExit, so that temporary files are removed.

    The exit code is the shell's code for the signal. An ignored signal (nohup) stays ignored. Only the main thread may
    set handlers; in other threads the block changes nothing.
    """

    def end(number: int, frame: FrameType | None) -> None:
        """Raise SystemExit with the code of the signal."""
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
