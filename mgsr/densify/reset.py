"""Opacity reset (3DGS, section 5.2): lowers every opacity, so that what isn't needed stays faint and is pruned."""

from __future__ import annotations

import math

from torch import Tensor

OPACITY_NAMES = ("opacity_logits", "refl_opacity_logits")


def lowered_opacities(parameters: dict[str, Tensor], opacity: float) -> dict[str, Tensor]:
    """Return the opacity logits of either branch, by name, lowered to at most that of `opacity`.

    `parameters` stay as they are.
    """
    limit = math.log(opacity / (1 - opacity))
    return {name: parameters[name].detach().clamp(max=limit) for name in OPACITY_NAMES if name in parameters}
