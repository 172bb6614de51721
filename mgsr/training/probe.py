"""Timing of a few iterations of each stage, on a plan that is thrown away."""

from __future__ import annotations

import statistics
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import torch

from mgsr.config import Config
from mgsr.data.scene import Scene
from mgsr.parallel import one_torch_thread
from mgsr.start.points import StartingPoints
from mgsr.training.control import TrainingControl
from mgsr.training.plan import make_plan
from mgsr.training.stage_scheduler import FINISH, StageLength
from mgsr.training.trainer import Trainer
from mgsr.training.views import CPU

UNTIMED, TIMED = 2, 4  # iterations; the first ones load kernels and fill memory


@dataclass(frozen=True)
class Probe:
    """The measured speed of training.

    seconds: the duration of one iteration of each stage, in order. splats: the number of splats of each branch.
    """

    seconds: dict[str, float]
    splats: dict[str, int]


def probe(scene: Scene, start: StartingPoints, config: Config, device: torch.device = CPU) -> Probe:
    """Measure how long an iteration of each stage before FINISH takes at the beginning.

    Raises the errors of `Training`.
    """
    timer = _Timer(device)
    with one_torch_thread():
        whole = replace(config.train, warmup=replace(config.train.warmup, coarse=0.0))  # reduced photographs are faster
        plan = replace(make_plan(scene, start, replace(config, train=whole), device), curve_views=[])
        splats = {branch.name: len(branch.model) for branch in plan.train_state.branches}
        Trainer(plan, config.train, {}, TrainingControl(scheduler=timer)).run(before=FINISH)
    return Probe({name: timer.median(name) for name in timer.times}, splats)


@dataclass
class _Timer:
    """A scheduler that records the time of each call, and ends each stage after a few iterations."""

    device: torch.device
    times: dict[str, list[float]] = field(default_factory=dict)

    def length(self, stages: Sequence[StageLength], index: int, splats: Mapping[str, int]) -> int:
        if self.device.type == "cuda":
            torch.cuda.synchronize(self.device)
        self.times.setdefault(stages[index].name, []).append(time.perf_counter())
        return UNTIMED + TIMED + 1

    def state(self) -> dict[str, Any]:
        return {}

    def median(self, stage: str) -> float:
        noted = self.times[stage]
        return statistics.median(
            after - before for before, after in zip(noted[UNTIMED:], noted[UNTIMED + 1 :], strict=False)
        )
