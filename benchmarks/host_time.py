"""The cost of a training iteration on a GPU for the host, measured without a GPU.

    python benchmarks/host_time.py [--iterations 100] [--reflection shared|both|own|off] [--operations] [--profile]

Kernels that do nothing stand in for the GPU's, and images are tiny, so that what is left is Python, torch's dispatch
and the packing of parameters: the whole iteration, with the guard, the optimisers and the statistics. Each stage's row
is the median processor time of an iteration, its launches, and the torch operations that are no views and make no
memory. Of each launch the driver's own share is missing.
"""

from __future__ import annotations

import argparse
import cProfile
import ctypes
import pstats
import statistics
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import torch
from torch.utils._python_dispatch import TorchDispatchMode

from mgsr.config import Config, make_config
from mgsr.native.cuda import tiles
from mgsr.native.cuda.launcher import use_launcher
from mgsr.training.guard import Guard
from mgsr.training.plan import Plan, make_plan
from mgsr.training.stages import Stage
from mgsr.training.trainer import Trainer
from tests.training.ball import ball_points, ball_scene

SIDE, SPLATS, PAIRS = 24, 80, 1000
# Operations that only look at memory, or only set it aside.
FREE = {"view", "t", "expand", "slice", "select", "detach", "unsqueeze", "permute", "as_strided", "alias", "squeeze"}
FREE |= {"transpose", "empty", "new_empty", "empty_like", "reshape", "unbind", "_unsafe_view", "split"}


@dataclass
class IdleLauncher:
    """A launcher whose kernels do nothing."""

    launched: int = 0

    def launch(self, family: str, kernel: str, blocks: int, threads: int, params: ctypes.Structure) -> None:
        self.launched += 1


class Operations(TorchDispatchMode):
    """A counter of torch's operations within the block."""

    def __init__(self) -> None:
        TorchDispatchMode.__init__(self)
        self.counts: Counter[str] = Counter()

    def __torch_dispatch__(self, op: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        name = op._schema.name.removeprefix("aten::")
        if name not in FREE:
            self.counts[name] += 1
        return op(*args, **(kwargs or {}))


@dataclass(frozen=True)
class Row:
    """The cost of an iteration of a stage: ms of processor time, launches and operations."""

    stage: str
    milliseconds: float
    launches: int
    operations: Counter[str] = field(repr=False)


def measure(plan: Plan, config: Config, iterations: int) -> list[Row]:
    """Return a row for each stage."""
    launcher, rows = IdleLauncher(), []
    with use_launcher(launcher), pairs_made_up():
        for stage in plan.stages:
            iterate = _iteration(plan, config, stage)
            for _ in range(20):
                iterate()
            launcher.launched = 0
            milliseconds = statistics.median(_timed(iterate) for _ in range(iterations))
            launches = round(launcher.launched / iterations)
            with Operations() as operations:
                iterate()
            rows.append(Row(stage.name, milliseconds, launches, operations.counts))
    return rows


def profile(plan: Plan, config: Config, iterations: int) -> None:
    """Print where the last stage's time goes."""
    with use_launcher(IdleLauncher()), pairs_made_up():
        iterate = _iteration(plan, config, plan.stages[-1])
        for _ in range(20):
            iterate()
        profiler = cProfile.Profile(time.process_time)
        profiler.enable()
        for _ in range(iterations):
            iterate()
        profiler.disable()
    pstats.Stats(profiler).sort_stats("tottime").print_stats(40)


@contextmanager
def pairs_made_up() -> Iterator[None]:
    """Make up the count of pairs within the block, as no kernel has found it."""
    before, tiles.read_later = tiles.read_later, lambda scalar: lambda: PAIRS
    try:
        yield
    finally:
        tiles.read_later = before


def _iteration(plan: Plan, config: Config, stage: Stage) -> Callable[[], object]:
    trainer = Trainer(plan, config.train, {})
    guard = Guard(stage, 10**9, [])
    return lambda: trainer._iterate(stage, guard)


def _timed(iterate: Callable[[], object]) -> float:
    begin = time.process_time()
    iterate()
    return 1000 * (time.process_time() - begin)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--iterations", type=int, default=100)
    parser.add_argument("--reflection", default="both", choices=["off", "own", "shared", "both"])
    parser.add_argument("--profile", action="store_true", help="profile the last stage")
    parser.add_argument("--operations", action="store_true", help="list the operations of the last stage")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    config = make_config("high", overrides=[f"reflection={arguments.reflection}", "environment_map.iterations=0"])
    plan = make_plan(ball_scene(SIDE, train=3, test=1, masked=True), ball_points(SPLATS), config)
    if arguments.profile:
        profile(plan, config, arguments.iterations)
        return
    print("| stage | host ms | launches | torch operations |\n|---|---|---|---|")
    rows = measure(plan, config, arguments.iterations)
    for row in rows:
        print(f"| {row.stage} | {row.milliseconds:.2f} | {row.launches} | {row.operations.total()} |")
    if arguments.operations:
        print(*(f"{count} {name}" for name, count in rows[-1].operations.most_common()), sep="\n")


if __name__ == "__main__":
    main()
