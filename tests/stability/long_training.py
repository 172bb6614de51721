"""A training as long as one likes on a tiny scene, looked at again and again: what could drift in it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from mgsr.config import make_config
from mgsr.parallel import one_torch_thread
from mgsr.training.control import TrainingControl
from mgsr.training.plan import Plan, make_plan
from mgsr.training.progress import Progress
from mgsr.training.trainer import Trainer
from tests.training.ball import ball_points, ball_scene

MOST_SPLATS = 300  # of a branch
LOOKS = 50
PAGE = 4096 / 2**20  # MiB


@dataclass(frozen=True)
class Look:
    """The state of a training after `done` iterations of all stages; figures over both branches."""

    stage: str
    done: int
    memory: float  # resident, MiB
    surfels: int
    gaussians: int
    shortest_quat: float
    longest_quat: float
    largest_logit: float  # of the opacities, absolute
    largest_parameter: float
    largest_moment: float  # of Adam, the first and the second
    not_finite: int  # numbers, parameters' and moments'
    incidents: int
    psnr: float  # of the 3D branch where there is one, of a held-out view; NaN before the first row of the curve


def long_training(iterations: int, seen: Callable[[Look], None] = lambda _: None, side: int = 32) -> list[Look]:
    """Train both branches from 200 points: two fifths of the iterations alone each, and one fifth together.

    `seen` is given each look at once.
    """
    warmup, every = 2 * iterations // 5, iterations // LOOKS
    overrides = [f"warmup.surfel_iterations={warmup}", f"warmup.gaussian_iterations={warmup}"]
    overrides += [f"mutual.iterations={iterations - 2 * warmup}", "stop_rule=none", "curve_views=1"]
    overrides += [f"curve_every={every}", f"report_every={every}"]
    overrides += [f"{branch}.densify.max_count={MOST_SPLATS}" for branch in ("surfels", "gaussians")]
    config = make_config("draft", "mgsr", 0, overrides)
    scene = ball_scene(side, train=8, test=1)
    plan = make_plan(scene, ball_points(200), config)
    looks: list[Look] = []

    def look(report: Progress) -> None:
        looks.append(_look(report, plan, len(trainer.incidents), iterations))
        seen(looks[-1])

    trainer = Trainer(plan, config.train, {}, TrainingControl(look))
    with one_torch_thread():
        trainer.run()
    return looks


def growth(looks: list[Look]) -> dict[str, float]:
    """Return the growth of memory in MiB per 10,000 iterations, by stage.

    It is the slope of a line through the looks after a stage's first third.
    """
    slopes = {}
    for stage in dict.fromkeys(look.stage for look in looks):
        of_stage = [look for look in looks if look.stage == stage]
        settled = of_stage[len(of_stage) // 3 :]
        done, memory = ([getattr(look, name) for look in settled] for name in ("done", "memory"))
        slopes[stage] = 1e4 * float(np.polyfit(done, memory, 1)[0])
    return slopes


def _look(report: Progress, plan: Plan, incidents: int, iterations: int) -> Look:
    parameters = {
        f"{part.name}.{name}": t for part in plan.train_state.trainables for name, t in part.tensors("values").items()
    }
    states = [part.state()["optimizer"][kind] for part in plan.train_state.trainables for kind in ("first", "second")]
    moments = [tensor for state in states for tensor in state.values()]
    quats = torch.cat([t.norm(dim=1) for name, t in parameters.items() if name.endswith(".quats")])
    logits = [t for name, t in parameters.items() if name.endswith("opacity_logits")]
    return Look(
        stage=report.stage,
        done=round(report.done * iterations),
        memory=int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * PAGE,
        surfels=report.counts.get("surfels", 0),
        gaussians=report.counts.get("gaussians", 0),
        shortest_quat=float(quats.min()),
        longest_quat=float(quats.max()),
        largest_logit=_largest(logits),
        largest_parameter=_largest(list(parameters.values())),
        largest_moment=_largest(moments),
        not_finite=sum(int((~torch.isfinite(t)).sum()) for t in [*parameters.values(), *moments]),
        incidents=incidents,
        psnr=float("nan") if report.psnr is None else report.psnr,
    )


def _largest(tensors: list[Tensor]) -> float:
    return max((float(t.abs().max()) for t in tensors if t.numel()), default=0.0)
