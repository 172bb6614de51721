"""Tie child processes to their parent, so that they die with it even if it is killed."""

from __future__ import annotations

import ctypes
import os
import signal
import sys

_PR_SET_PDEATHSIG = 1


def die_with_parent(parent: int, number: signal.Signals = signal.SIGKILL) -> None:
    """Make the kernel send this process a signal when its parent ends. Exits now if `parent` is gone already.

    number: the signal. The setting outlasts exec. It has no effect on systems other than Linux.
    """
    if not sys.platform.startswith("linux"):
        return
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(_PR_SET_PDEATHSIG, int(number), 0, 0, 0) != 0:
        raise OSError(ctypes.get_errno(), "prctl(PR_SET_PDEATHSIG)")
    if os.getppid() != parent:
        os.kill(os.getpid(), number)


def main() -> None:
    """Replace this process by the program in the arguments, tied to the parent.

    python -m service.contract.lifeline PARENT PROGRAM ARGUMENT...
    """
    parent, program, *arguments = sys.argv[1:]
    die_with_parent(int(parent))
    os.execvp(program, [program, *arguments])


if __name__ == "__main__":
    main()
