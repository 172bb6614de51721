"""What changes with a run's progress: learning rates and the degree of the colours."""

from __future__ import annotations

import math

from mgsr.config import RatesConfig

Rates = dict[str, float | tuple[float, float]]


def rates_at(progress: float, config: RatesConfig, extent: float) -> Rates:
    """Each parameter's learning rate at `progress` 0..1 through the whole run, whatever its iterations.

    A pair is for colour coefficients: the constant term's and the others'. extent: the scene's, in its unit; the
    positions' rate is proportional to it.
    """
    fade = config.final**progress
    position = extent * math.exp(
        (1 - progress) * math.log(config.position) + progress * math.log(config.position_end)
    )
    sh = (fade * config.sh, fade * config.sh_rest)
    return {
        "means": position,
        "quats": fade * config.rotation,
        "log_scales": fade * config.scale,
        "opacity_logits": fade * config.opacity,
        "sh": sh,
        "refl_opacity_logits": fade * config.opacity,
        "weight_logits": fade * config.weight,
        "refl_sh": sh,
    }


def sh_degree_at(iteration: int, warmup_iterations: int, step: float, highest: int) -> int:
    """The colours' degree in the warm-up: from 0, one more each `step` (a fraction of the warm-up), to `highest`."""
    if step <= 0:
        return highest
    return min(highest, int(iteration / max(1.0, step * warmup_iterations)))
