"""The depth loss: how well the two branches' depths agree."""

from __future__ import annotations

from torch import Tensor

from mgsr.config import DepthUnit
from mgsr.ops.pixels import squares_term
from mgsr.ops.terms import Term

LEAST_DISTANCE = 0.1  # scene units


def depth_agreement(
    gaussian_depth: Tensor, surfel_depth: Tensor, covered: tuple[Tensor, Tensor], unit: float | Tensor
) -> Term:
    """Return L_depth: the mean over all pixels of ((depth_3D - depth_2D) / unit)^2 where both branches cover.

    Depths [H,W] camera z; covered: two of [H,W], 0 or 1. Gradients flow to both depths.
    """
    return squares_term(gaussian_depth, surfel_depth, covered, by=gaussian_depth.numel() * unit**2)


def depth_unit(kind: DepthUnit, gaussian_depth: Tensor, distance: float) -> float | Tensor:
    """Return the unit that `depth_agreement` divides by: the camera's distance from the scene's centre.

    As in the paper, it may be the largest depth instead (one for both, so that depths which agree still agree after
    it). A distance under 0.1 counts as that: a camera in the middle of the scene, whose radius is 1, would else weigh
    without bound.
    """
    return (
        max(distance, LEAST_DISTANCE) if kind is DepthUnit.DISTANCE else gaussian_depth.detach().max().clamp(min=1e-6)
    )
