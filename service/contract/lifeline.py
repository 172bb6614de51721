"""Children that die with their parent, even when it is killed without warning."""

from __future__ import annotations

import ctypes
import os
import signal
import sys

_PR_SET_PDEATHSIG = 1


def die_with_parent(parent: int, number: signal.Signals = signal.SIGKILL) -> None:
    """Have the kernel send this process `number` when its parent ends; end now if `parent` is gone already.

    On systems other than Linux nothing happens. The setting outlasts exec.
    """
    if not sys.platform.startswith("linux"):
        return
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(_PR_SET_PDEATHSIG, int(number), 0, 0, 0) != 0:
        raise OSError(ctypes.get_errno(), "prctl(PR_SET_PDEATHSIG)")
    if os.getppid() != parent:
        os.kill(os.getpid(), number)


def main() -> None:
    """Become the program that the arguments name, tied to the parent.

    python -m service.contract.lifeline PARENT PROGRAM ARGUMENT...
    """
    parent, program, *arguments = sys.argv[1:]
    die_with_parent(int(parent))
    os.execvp(program, [program, *arguments])


if __name__ == "__main__":
    main()
