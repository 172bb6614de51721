"""The silhouette loss: how well the rendered alpha agrees with the mask."""

from __future__ import annotations

from torch import Tensor

from mgsr.config import AlphaLoss
from mgsr.ops.pixels import silhouette_term
from mgsr.ops.terms import Term


def silhouette(alpha: Tensor, mask: Tensor, kind: AlphaLoss, where: Tensor | None = None) -> Term:
    """Return the silhouette loss of the rendered alpha [H,W] against the photograph's mask [H,W], both 0..1.

    kind: the mean absolute difference or the cross entropy. where [H,W]: weights of the pixels, all 1 by default (the
    mean stays over all pixels). Gradients flow to alpha.
    """
    return silhouette_term(alpha, mask, where, entropy=kind is AlphaLoss.BCE)
