"""The branches' losses, put together from their terms (supplement, Algorithms 1 and 2).

Each function returns its terms by name, already times their weights: their sum is the loss, and a term that goes
wrong can be named. A term whose weight is zero is not computed.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from mgsr.config import SurfaceDepth, Teaching, TrainConfig
from mgsr.losses.alpha import silhouette
from mgsr.losses.depths import depth_agreement, depth_unit
from mgsr.losses.normals import normal_agreement
from mgsr.losses.target import Target
from mgsr.ops.image_loss import image_loss
from mgsr.ops.tv import edge_aware_tv
from mgsr.render.outputs import SurfelOutputs, VolumeOutputs

Terms = dict[str, Tensor]


def surfel_terms(outputs: SurfelOutputs, target: Target, config: TrainConfig, regularised: bool = True) -> Terms:
    """L_2D of the warm-up: the photograph, the silhouette and, if `regularised`, the surface's smoothness."""
    terms = {"surfels.photo": _photo(outputs.color, target.color, target, config, target.off_edge)}
    terms |= _silhouette("surfels", outputs.alpha, target, config.surfels.alpha_weight, config, target.off_edge)
    return terms | (surface_terms(outputs, target, config) if regularised else {})


def volume_terms(outputs: VolumeOutputs, target: Target, config: TrainConfig) -> Terms:
    """L_3D: the photograph, the silhouette, and the transmitted colour's smoothness."""
    settings = config.volumes
    # Photographs clip: where they are white, a render that is brighter is as right as one that is white.
    terms = {"volumes.photo": _photo(outputs.color.clamp(max=1), target.color, target, config)}
    terms |= _silhouette("volumes", outputs.alpha, target, settings.alpha_weight, config)
    if config.tv and settings.transmitted_tv_weight:
        # With masks only inside: the step to a random background is no texture to smooth away.
        inside = None if target.unknown is None else target.known(torch.ones_like(outputs.alpha))
        inside = inside if target.alpha is None else target.covered(outputs.alpha)
        tv = edge_aware_tv(outputs.transmitted, target.color, mask=inside)
        terms["volumes.transmitted_tv"] = settings.transmitted_tv_weight * tv
    if settings.reflected_cost and outputs.reflected is not outputs.mirrored:
        terms["volumes.reflected_cost"] = settings.reflected_cost * _added_by_splats(outputs)
    if config.tv and settings.depth_tv_weight:
        tv = edge_aware_tv(_rendered(outputs.depth), target.color, mask=target.covered(outputs.alpha))
        terms["volumes.depth_tv"] = settings.depth_tv_weight * tv
    return terms


def mutual_terms(surfels: SurfelOutputs, volumes: VolumeOutputs, target: Target, config: TrainConfig) -> Terms:
    """L_total of the mutual phase, times the branches' weights.

    The 2D branch's target is the photograph and the 3D branch's transmitted image, which also guides its smoothness;
    the two depths pull at each other. Taught one way, the transmitted image and the surface's depth stay as they are.
    """
    settings, both = config.mutual, config.mutual.teaching is Teaching.BOTH_WAYS
    transmitted = volumes.transmitted if both else volumes.transmitted.detach()
    depth, where = surface_depth(surfels, config), target.off_edge
    terms = {
        "surfels.photo": settings.photo_weight * _photo(surfels.color, target.color, target, config, where),
        "surfels.transmitted": (1 - settings.photo_weight) * _photo(surfels.color, transmitted, target, config, where),
    }
    terms |= _silhouette("surfels", surfels.alpha, target, config.surfels.alpha_weight, config, where)
    terms |= surface_terms(surfels, replace(target, color=volumes.transmitted.detach()), config)
    terms = {name: settings.surfel_weight * term for name, term in terms.items()}
    for name, term in volume_terms(volumes, target, config).items():
        terms[name] = settings.volume_weight * term
    if settings.depth_weight:
        full_depth = _rendered(volumes.depth)
        unit = depth_unit(settings.depth_unit, full_depth, target.distance)
        covered = target.covered(surfels.alpha) * target.covered(volumes.alpha)
        agreement = depth_agreement(full_depth, depth if both else depth.detach(), covered, unit)
        terms["mutual.depth"] = settings.depth_weight * agreement
    return terms


def surface_terms(outputs: SurfelOutputs, target: Target, config: TrainConfig) -> Terms:
    """What shapes the surface: lambda_3 (L_n + lambda_4 TV(N)) + lambda_5 TV(depth), guided by the target's colour,
    and 2DGS's distortion where it has a weight."""
    settings = config.surfels
    depth, covered = surface_depth(outputs, config), target.covered(outputs.alpha)
    terms: Terms = {}
    if settings.normal_weight:
        agreement = normal_agreement(outputs.normal, depth, outputs.alpha, target.camera, covered)
        terms["surfels.normal"] = settings.normal_weight * agreement
    if config.tv and settings.normal_weight * settings.normal_tv_weight:
        tv = edge_aware_tv(outputs.normal, target.color, mask=covered)
        terms["surfels.normal_tv"] = settings.normal_weight * settings.normal_tv_weight * tv
    if config.tv and settings.depth_tv_weight:
        terms["surfels.depth_tv"] = settings.depth_tv_weight * edge_aware_tv(depth, target.color, mask=covered)
    if settings.distortion_weight and outputs.distortion is not None:
        terms["surfels.distortion"] = settings.distortion_weight * outputs.distortion.mean()
    return terms


def surface_depth(outputs: SurfelOutputs, config: TrainConfig) -> Tensor:
    """The depth [H,W] that counts as the surface."""
    return outputs.depth if config.surfels.depth is SurfaceDepth.EXPECTED else outputs.median_depth


def _photo(image: Tensor, other: Tensor, target: Target, config: TrainConfig, where: Tensor | None = None) -> Tensor:
    image, other = target.compared(image, other)
    return image_loss(image, other, l1_weight=config.l1_weight, mask=where, region=target.region)


def _added_by_splats(outputs: VolumeOutputs) -> Tensor:
    """The mean of the reflected light that splats add of their own. It is never negative, so this is its L1 norm."""
    added = (outputs.color - outputs.transmitted).mean()
    if outputs.mirrored is None or outputs.weight is None:
        return added
    return added - (outputs.weight * outputs.mirrored.mean(dim=-1)).mean()


def _rendered(depth: Tensor | None) -> Tensor:
    assert depth is not None, "the stage rendered no depth"
    return depth


def _silhouette(
    branch: str, alpha: Tensor, target: Target, weight: float, config: TrainConfig, where: Tensor | None = None
) -> Terms:
    if target.alpha is None or not weight:
        return {}
    alpha, mask = target.compared(alpha, target.alpha)
    return {f"{branch}.alpha": weight * silhouette(alpha, mask, config.alpha_loss, where)}
