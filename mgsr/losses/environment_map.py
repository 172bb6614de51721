"""Regularisers of the environment maps, and of how glossy splats are, where photographs say little of them."""

from __future__ import annotations

from torch import Tensor

from mgsr.config import TrainConfig
from mgsr.gaussians.gaussians import GaussianModel
from mgsr.gaussians.start import logit
from mgsr.losses.objective import Terms
from mgsr.ops.pixels import squares_term, steps_term


def environment_map_terms(maps: Tensor, gaussians: GaussianModel, config: TrainConfig) -> Terms:
    """Return the regularisers of the environment maps [2,S,S,3] and of the splats' reflection weights, by name.

    The maps' smoothness is the mean square of differences between neighbours. Each splat's reflection weight is pulled
    to where it began, so that a place where no photograph saw a highlight stays as glossy as the rest.
    """
    settings = config.environment_map
    terms: Terms = {"environment_map.smooth": settings.smoothness * steps_term(maps)}
    if gaussians.weight_logits is not None:
        away = squares_term(gaussians.weight_logits, offset=logit(config.gaussians.start_weight))
        terms["environment_map.weights"] = settings.weight_prior * away
    return terms
