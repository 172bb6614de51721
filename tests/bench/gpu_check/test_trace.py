"""The reader of profiles: a trace with a known answer, and a training on the CPU."""

from __future__ import annotations

import json
from dataclasses import astuple
from pathlib import Path
from typing import Any

import pytest
import torch
from torch.profiler import ProfilerActivity, profile

from benchmarks.gpu_check import profile_training, trace
from benchmarks.packed_scenes import Packed
from mgsr.config import make_config
from mgsr.training.progress import Progress
from tests.training.ball import ball_points, ball_scene

SETTINGS = (
    *(
        "warmup.surfel_iterations=10",
        "warmup.gaussian_iterations=10",
        "mutual.iterations=60",
        "model_selection.iterations=0",
    ),
    *("surfels.densify.every=10", "gaussians.densify.every=10", "watch.report_every=10", "reflection=both"),
)
CONFIG = make_config("draft", overrides=SETTINGS)
CPU = torch.device("cpu")


def entry(kind: str, name: str, begin: float, duration: float, thread: int = 7) -> dict[str, Any]:
    return {"ph": "X", "cat": kind, "name": name, "ts": begin, "dur": duration, "pid": 0, "tid": thread}


@pytest.fixture
def events(tmp_path: Path) -> list[trace.Event]:
    """Build the events of two iterations.

    Kernels at 100..150 and within, 120..130, on another stream, 170..180 and 400..420, a copy at 180..190.
    """
    entries = [
        entry("kernel", "sort", 100, 50, thread=8),
        entry("kernel", "blend", 120, 10),
        entry("kernel", "blend", 170, 10),
        entry("gpu_memcpy", "Memcpy DtoH", 180, 10),
        entry("kernel", "sort", 400, 20),
        entry("cuda_runtime", "cudaEventSynchronize", 190, 100),
        entry("cuda_driver", "cuLaunchKernel", 300, 5),
        entry("cpu_op", "aten::to", 10, 20),
        entry("cpu_op", "aten::_to_copy", 11, 18),
        entry("cpu_op", "aten::copy_", 12, 10),
        entry("cpu_op", "autograd::engine::evaluate_function: MulBackward0", 40, 30),
        entry("cpu_op", "aten::mul", 45, 10),
        entry("cpu_op", "aten::view", 56, 2),
        entry("cpu_op", "aten::mul", 45, 10, thread=8),
        {"ph": "i", "name": "a mark", "ts": 5},
    ]
    path = tmp_path / "trace.json"
    path.write_text(json.dumps({"traceEvents": entries}))
    return trace.read_trace(path)


def test_kernels_of_a_known_trace(events: list[trace.Event]) -> None:
    assert trace.busy(events) == pytest.approx(0.090)  # 100..150, 170..190 and 400..420
    assert trace.launches(events) == 4
    assert trace.waits(events) == pytest.approx(0.1)
    rows = {row.name: row for row in trace.kernel_rows(events, iterations=2)}
    assert [row.name for row in trace.kernel_rows(events, 2)] == ["sort", "blend", "Memcpy DtoH"]
    assert astuple(rows["sort"]) == ("sort", 1.0, 0.035, 35.0, pytest.approx(0.7))
    assert rows["blend"].milliseconds == pytest.approx(0.010) and rows["blend"].median == 10


def test_gaps_of_a_known_trace(events: list[trace.Event]) -> None:
    assert trace.gaps(events) == [trace.Gap(210, "Memcpy DtoH", "sort"), trace.Gap(20, "sort", "blend")]


def test_operations_of_a_known_trace(events: list[trace.Event]) -> None:
    """Check that operations are counted without what they call, without views and without autograd's own wrappers."""
    assert trace.operations(events) == {"mul": 2, "to": 1}


def test_operations_that_torch_records(tmp_path: Path) -> None:
    x = torch.ones(8, 8, requires_grad=True)
    with profile(activities=[ProfilerActivity.CPU]) as recorded:
        (x.view(64) * 2).sum()
        x.transpose(0, 1).add(1)
    recorded.export_chrome_trace(str(tmp_path / "trace.json"))
    assert trace.operations(trace.read_trace(tmp_path / "trace.json")) == {"mul": 1, "sum": 1, "add": 1}


def test_a_profile_of_a_training(tmp_path: Path) -> None:
    content = Packed(ball_scene(size=32, train=6), ball_points(300), {})
    found = profile_training.profiled(content, CONFIG, CPU, count=5, after=1e9, work=tmp_path)
    assert found is not None
    assert (found.where.stage, found.where.iteration, found.where.total) == ("mutual", 20, 60)
    assert [stretch.iterations for stretch in (found.plain, found.gpu, found.all)] == [10, 5, 5]
    numbers = profile_training.numbers(found)
    assert 0.1 < numbers["wall_ms_each"] < 1000 and numbers["host_cpu_ms_each"] > 0
    assert numbers["gpu_busy_ms_each"] == numbers["kernels_each"] == 0
    assert 20 < numbers["torch_operations_each"] < 2000
    inside = [event for event in found.all.events if event.kind == "cpu_op"]
    assert inside[-1].begin - inside[0].begin <= found.all.wall * 1e3
    most = next(iter(trace.operations(found.all.events)))
    text = "\n".join(profile_training.lines(found))
    assert "from iteration 20 of 60 of mutual" in text and f"| {most} |" in text
    json.dumps(profile_training.row(found))


def test_the_last_stretch_ends_with_a_densification(tmp_path: Path) -> None:
    """Check that the last stretch ends where the loop adds and removes splats.

    The profile is to have its share of that.
    """
    watch = profile_training.Watch(CONFIG, CPU, 5, 1e9, tmp_path)
    asked = list[tuple[int, int]]()

    for iteration in range(1, 61):
        if watch.should_stop():
            break
        asked.append((iteration, len(watch.made)))
        if iteration % 5 == 0:
            watch.progress(Progress("mutual", iteration, 60, 0.5, 1.0, {}, {}, None))
    ended = [next(i for i, made in asked if made == count) - 1 for count in (1, 2)]
    assert [*ended, asked[-1][0]] == [30, 40, 50]


def test_no_profile_of_a_training_that_is_too_short(tmp_path: Path) -> None:
    short = make_config("draft", overrides=[*SETTINGS, "mutual.iterations=20"])
    content = Packed(ball_scene(size=16, train=4), ball_points(100), {})
    assert profile_training.profiled(content, short, CPU, count=5, after=1e9, work=tmp_path) is None


def test_a_slow_training_is_profiled_where_it_is(tmp_path: Path) -> None:
    content = Packed(ball_scene(size=16, train=4), ball_points(100), {})
    settings = [*SETTINGS, "warmup.surfel_iterations=60", "stop_rule=none"]
    slow = make_config("draft", overrides=settings)
    found = profile_training.profiled(content, slow, CPU, count=5, after=0.0, work=tmp_path)
    assert found is not None and (found.where.stage, found.where.iteration) == ("warmup_surfels", 10)
