"""Read a trace of torch's profiler (Chrome's format): kernels, gaps, waits, launches and torch's operations."""

from __future__ import annotations

import json
import statistics
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

GPU = {"kernel", "gpu_memcpy", "gpu_memset"}
RUNTIME = {"cuda_runtime", "cuda_driver"}
# Operations that only look at a tensor in another way.
VIEWS = {
    *("view", "view_as", "reshape", "_unsafe_view", "expand", "expand_as", "slice", "select", "narrow", "unfold"),
    *("t", "transpose", "permute", "movedim", "unsqueeze", "squeeze", "flatten", "unflatten", "diagonal"),
    *("as_strided", "alias", "unbind", "split", "chunk", "detach", "detach_", "lift_fresh"),
}


@dataclass(frozen=True)
class Event:
    """An event of the trace that took time, in microseconds."""

    kind: str
    name: str
    begin: float
    duration: float
    thread: tuple[Any, Any]

    @property
    def end(self) -> float:
        return self.begin + self.duration


@dataclass(frozen=True)
class KernelRow:
    """All runs of one kernel.

    How often and how long, milliseconds, an iteration; the median run, microseconds; its share of the time of all
    kernels.
    """

    name: str
    runs: float
    milliseconds: float
    median: float
    share: float


@dataclass(frozen=True)
class Gap:
    """A time, in microseconds, in which the GPU did nothing, between two things that it did."""

    length: float
    before: str
    after: str


def read_trace(path: Path) -> list[Event]:
    """Return the events of a trace that took time, by their begin."""
    with path.open() as file:
        entries = json.load(file)["traceEvents"]
    events = [
        Event(entry.get("cat", ""), entry["name"], entry["ts"], entry["dur"], (entry.get("pid"), entry.get("tid")))
        for entry in entries
        if entry.get("ph") == "X"
    ]
    return sorted(events, key=lambda event: (event.begin, -event.duration))


def kernel_rows(events: Iterable[Event], iterations: int) -> list[KernelRow]:
    """Return what runs on the GPU, by its name, the longest first."""
    runs = defaultdict[str, list[float]](list)
    for event in on_gpu(events):
        runs[event.name].append(event.duration)
    total = sum(map(sum, runs.values()))
    rows = [
        KernelRow(
            name,
            len(times) / iterations,
            sum(times) / 1e3 / iterations,
            statistics.median(times),
            sum(times) / total,
        )
        for name, times in runs.items()
    ]
    return sorted(rows, key=lambda row: -row.milliseconds)


def on_gpu(events: Iterable[Event]) -> list[Event]:
    """Return the kernels, copies and fills."""
    return [event for event in events if event.kind in GPU]


def busy(events: Iterable[Event]) -> float:
    """Return the milliseconds in which the GPU did something; what runs at the same time counts once."""
    total, reached = 0.0, float("-inf")
    for event in on_gpu(events):
        total += max(0.0, event.end - max(event.begin, reached))
        reached = max(reached, event.end)
    return total / 1e3


def gaps(events: Iterable[Event]) -> list[Gap]:
    """Return the gaps between events on the GPU, the longest first."""
    found, last = list[Gap](), None
    for event in on_gpu(events):
        if last is not None and event.begin > last.end:
            found.append(Gap(event.begin - last.end, last.name, event.name))
        if last is None or event.end > last.end:
            last = event
    return sorted(found, key=lambda gap: -gap.length)


def waits(events: Iterable[Event]) -> float:
    """Return the milliseconds in which the host waited for the GPU."""
    return sum(e.duration for e in events if e.kind in RUNTIME and "Synchronize" in e.name) / 1e3


def launches(events: Iterable[Event]) -> int:
    """Return how many kernels the GPU ran."""
    return sum(event.kind == "kernel" for event in events)


def operations(events: Iterable[Event]) -> dict[str, int]:
    """Count torch's operations that were asked for, but for views, by name; what one calls inside is not counted."""
    counts, ends = defaultdict[str, int](int), dict[tuple[Any, Any], float]()
    for event in events:
        if event.kind != "cpu_op" or not event.name.startswith("aten::"):
            continue
        if event.begin >= ends.get(event.thread, float("-inf")):
            ends[event.thread] = event.end
            counts[event.name.removeprefix("aten::")] += 1
    return {name: counts[name] for name in sorted(counts, key=lambda name: -counts[name]) if name not in VIEWS}
