"""How well the rendered silhouette agrees with the mask."""

from __future__ import annotations

from torch import Tensor

from mgsr.config import AlphaLoss
from mgsr.ops.pixels import silhouette_term
from mgsr.ops.terms import Term


def silhouette(alpha: Tensor, mask: Tensor, kind: AlphaLoss, where: Tensor | None = None) -> Term:
    """Mean difference of the rendered alpha [H,W] from the photograph's [H,W], both 0..1; gradient to alpha. where
    [H,W]: weights of the pixels, all 1 by default (the mean stays over all pixels)."""
    return silhouette_term(alpha, mask, where, entropy=kind is AlphaLoss.BCE)
