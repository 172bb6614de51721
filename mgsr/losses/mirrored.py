"""What holds the shared light, and how glossy splats are, where photographs say little of them."""

from __future__ import annotations

from torch import Tensor

from mgsr.config import TrainConfig
from mgsr.gaussians.start import logit
from mgsr.gaussians.volumes import VolumeModel
from mgsr.losses.objective import Terms
from mgsr.ops.pixels import squares_term, steps_term


def light_terms(maps: Tensor, volumes: VolumeModel, config: TrainConfig) -> Terms:
    """Return the smoothness of the light's maps [2,S,S,3], the mean square of differences between neighbours; and a
    pull of each splat's reflection weight to where it began, so that a place where no photograph saw a highlight stays
    as glossy as the rest."""
    settings = config.mirror
    terms: Terms = {"light.smooth": settings.smoothness * steps_term(maps)}
    if volumes.weight_logits is not None:
        away = squares_term(volumes.weight_logits, offset=logit(config.volumes.start_weight))
        terms["light.weights"] = settings.weight_hold * away
    return terms
