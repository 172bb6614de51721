"""What changes with a run's progress: learning rates and the degree of the colours."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from mgsr.config import RatesConfig

SH_NAMES = ("sh", "refl_sh")


def rates_at(progress: float, config: RatesConfig, extent: float) -> dict[str, float]:
    """Each parameter's learning rate at `progress` 0..1 through the whole run, whatever its iterations.

    extent: the scene's, in its unit; the positions' rate is proportional to it. Of colours it is the constant term's
    (see `rest_scale`).
    """
    faded = fade(progress, config.fade_from, config.final)
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


def fade(progress: float, begin: float, final: float) -> float:
    """1 until `progress` is `begin`, then falling exponentially to `final` at 1."""
    return float(final ** (max(0.0, progress - begin) / max(1 - begin, 1e-9)))


def rest_scale(sh: Tensor, config: RatesConfig) -> Tensor:
    """What multiplies the rate of each coefficient of colours [N,K,3]: [K,3], 1 for the constant term."""
    scale = torch.full(sh.shape[1:], config.sh_rest / config.sh, device=sh.device)
    scale[0] = 1.0
    return scale


def sh_degree_at(iteration: int, warmup_iterations: int, step: float, highest: int) -> int:
    """The colours' degree in the warm-up: from 0, one more each `step` (a fraction of the warm-up), to `highest`."""
    if step <= 0:
        return highest
    return min(highest, int(iteration / max(1.0, step * warmup_iterations)))
