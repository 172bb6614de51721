"""Schedules over a run's progress: learning rates and the degree of the colours."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from mgsr.config import RatesConfig

SH_NAMES = ("sh", "refl_sh")


def rates_at(progress: float, config: RatesConfig, extent: float) -> dict[str, float]:
    """Return each parameter's learning rate at `progress` 0..1 through the whole run, whatever its iterations.

    extent: the scene's size, in its unit; the positions' rate is proportional to it. The rate of colours is that of
    the constant term (see `rest_scale`).
    """
    faded = decay(progress, config.decay_from, config.final_factor)
    position = extent * math.exp((1 - progress) * math.log(config.position) + progress * math.log(config.position_end))
    return {
        "means": position,
        "quats": faded * config.rotation,
        "log_scales": faded * config.scale,
        "opacity_logits": faded * config.opacity,
        "sh": faded * config.sh,
        "refl_opacity_logits": faded * config.opacity,
        "weight_logits": faded * config.weight,
        "refl_sh": faded * config.sh,
    }


def decay(progress: float, begin: float, final: float) -> float:
    """Return a factor that is 1 until `progress` is `begin`, and then falls exponentially to `final` at 1."""
    return float(final ** (max(0.0, progress - begin) / max(1 - begin, 1e-9)))


def rest_scale(sh: Tensor, config: RatesConfig) -> Tensor:
    """Return the factors [K,3] on the learning rate of each coefficient of colours [N,K,3]; 1 for the constant term."""
    scale = torch.full(sh.shape[1:], config.sh_rest / config.sh, device=sh.device)
    scale[0] = 1.0
    return scale


def sh_degree_at(iteration: int, warmup_iterations: int, step: float, highest: int) -> int:
    """Return the degree of the colours in the warm-up, which rises from 0 to `highest`.

    step: the degree rises by one after each such fraction of the warm-up; with 0, it is `highest` at once.
    """
    if step <= 0:
        return highest
    return min(highest, int(iteration / max(1.0, step * warmup_iterations)))
