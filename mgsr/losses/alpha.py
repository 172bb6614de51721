"""How well the rendered silhouette agrees with the mask."""

from __future__ import annotations

import torch
from torch import Tensor

from mgsr.config import AlphaLoss


def silhouette(alpha: Tensor, mask: Tensor, kind: AlphaLoss, where: Tensor | None = None) -> Tensor:
    """Mean difference of the rendered alpha [H,W] from the photograph's [H,W], both 0..1, a scalar; gradient to
    alpha. where [H,W]: weights of the pixels, all 1 by default (the mean stays over all pixels)."""
    if where is not None:
        alpha, mask = alpha * where, mask * where
    if kind is AlphaLoss.L1:
        return torch.nn.functional.l1_loss(alpha, mask)
    return torch.nn.functional.binary_cross_entropy(alpha.clamp(1e-4, 1 - 1e-4), mask)
