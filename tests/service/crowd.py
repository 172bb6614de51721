"""Many clients of one job, in a process of their own: `python -m tests.service.crowd PORT JOB SECONDS`.

300 poll its status, each once a second over a connection that it keeps, and 50 follow its events. Prints JSON: the
seconds of every answer, sorted; how many events came to each follower; the share of a core that all this took.
"""

from __future__ import annotations

import asyncio
import json
import random
import sys
import time

POLLERS, FOLLOWERS = 300, 50
PERIOD = 1.0


async def poll(port: int, job: str, ends: float, took: list[float]) -> None:
    """Ask once a second; each answer must be a 200."""
    await asyncio.sleep(random.uniform(0, PERIOD))
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    request = f"GET /jobs/{job} HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n".encode()
    while time.monotonic() < ends:
        started_at = time.monotonic()
        writer.write(request)
        head = await reader.readuntil(b"\r\n\r\n")
        assert head.startswith(b"HTTP/1.1 200"), head
        length = next(line for line in head.lower().split(b"\r\n") if line.startswith(b"content-length:"))
        await reader.readexactly(int(length.split(b":")[1]))
        took.append(time.monotonic() - started_at)
        await asyncio.sleep(max(0.0, PERIOD - (time.monotonic() - started_at)))
    writer.close()


async def follow(port: int, job: str, ends: float) -> int:
    """Return how many events came."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(f"GET /jobs/{job}/events HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n".encode())
    events = 0
    while (left := ends - time.monotonic()) > 0:
        try:
            events += (await asyncio.wait_for(reader.readline(), left)).startswith(b"event: progress")
        except TimeoutError:
            break
    writer.close()
    return events


async def crowd(port: int, job: str, seconds: float) -> None:
    """Run all clients at once, and print what they measured."""
    started_at, used = time.monotonic(), time.process_time()
    ends = started_at + seconds
    took: list[float] = []
    following = asyncio.gather(*(follow(port, job, ends) for _ in range(FOLLOWERS)))
    await asyncio.gather(*(poll(port, job, ends, took) for _ in range(POLLERS)))
    events = await following
    share = (time.process_time() - used) / (time.monotonic() - started_at)
    print(json.dumps({"took": sorted(took), "events": events, "share": share}))


if __name__ == "__main__":
    asyncio.run(crowd(int(sys.argv[1]), sys.argv[2], float(sys.argv[3])))
