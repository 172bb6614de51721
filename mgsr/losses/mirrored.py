"""What holds the shared light, and how glossy splats are, where photographs say little of them."""

from __future__ import annotations

from mgsr.config import TrainConfig
from mgsr.gaussians.mirrored import MirroredLight
from mgsr.gaussians.start import logit
from mgsr.gaussians.volumes import VolumeModel
from mgsr.losses.objective import Terms


def light_terms(light: MirroredLight, volumes: VolumeModel, config: TrainConfig) -> Terms:
    """The maps' smoothness, the mean square of differences between neighbours; and a pull of each splat's reflection
    weight to where it began, so that a place where no photograph saw a highlight stays as glossy as the rest."""
    settings, maps = config.mirror, light.maps()
    steps = [maps[..., 1:] - maps[..., :-1], maps[..., 1:, :] - maps[..., :-1, :]]
    terms = {"light.smooth": settings.smoothness * sum((step.square().mean() for step in steps), maps.new_zeros(()))}
    if volumes.weight_logits is not None:
        away = volumes.weight_logits - logit(config.volumes.start_weight)
        terms["light.weights"] = settings.weight_hold * away.square().sum()
    return terms
