"""Take as much of a core as a crowd of clients does, but ask nothing of the service.

Run it as `python -m tests.service.burn SHARE SECONDS`. It works in slices of some milliseconds, since clients wake up
often and work shortly.
"""

from __future__ import annotations

import sys
import time

SLICE = 0.005


def burn(share: float, seconds: float) -> None:
    """Use `share` of a core for so long, or as much of it as there is."""
    ends = time.monotonic() + seconds
    while (started_at := time.monotonic()) < ends:
        until = time.process_time() + SLICE * share
        while time.process_time() < until:
            sum(range(1000))
        time.sleep(max(0.0, SLICE - (time.monotonic() - started_at)))


if __name__ == "__main__":
    burn(float(sys.argv[1]), float(sys.argv[2]))
