"""Opacity reset (3DGS, section 5.2): lowers every opacity so that what isn't needed stays faint and is pruned."""

from __future__ import annotations

import math

import torch
from torch import Tensor

RESET_NAMES = ("opacity_logits", "refl_opacity_logits")


def reset_opacities(parameters: dict[str, Tensor], opacity: float) -> list[str]:
    """Lower the stored opacities of `parameters` in place to at most `opacity`; returns the names that changed, whose
    optimiser state the caller should clear."""
    limit = math.log(opacity / (1 - opacity))
    changed = [name for name in RESET_NAMES if name in parameters]
    with torch.no_grad():
        for name in changed:
            parameters[name].clamp_(max=limit)
    return changed
