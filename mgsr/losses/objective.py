"""The branches' losses, put together from their terms (supplement, Algorithms 1 and 2).

Each function returns its terms by name, already times their weights: `total` sums them up, and a term that goes wrong
can be named. A term whose weight is zero is not computed. Means over a part of a photograph are multiplied by the
part's share of the pixels (`Target.share`), and thus cost what they cost in the whole photograph; means over the
object's pixels are not.
"""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from mgsr.config import AlphaLoss, DepthUnit, SurfaceDepth, Teaching, TrainConfig
from mgsr.gaussians.gaussians import GaussianModel
from mgsr.gaussians.start import logit
from mgsr.losses.loss import Loss
from mgsr.losses.target import Target
from mgsr.ops.depth_normals import normal_agreement_term
from mgsr.ops.image_loss import image_loss_term
from mgsr.ops.pixels import product_term, silhouette_term, squares_term, steps_term
from mgsr.ops.terms import Term, evaluate
from mgsr.ops.tv import edge_aware_tv_term
from mgsr.renderers.outputs import GaussianOutputs, SurfelOutputs

LEAST_DISTANCE = 0.1  # scene units

Terms = dict[str, Term | Tensor]  # a Tensor [] is a term that torch differentiates


def total(terms: Mapping[str, Term | Tensor]) -> Loss:
    """Evaluate the terms by name, and return the loss that sums them; a Tensor [] is a term that torch
    differentiates."""
    names = [name for name, term in terms.items() if isinstance(term, Term)]
    others = {name: term for name, term in terms.items() if isinstance(term, Tensor)}
    return Loss(evaluate([term for term in terms.values() if isinstance(term, Term)]), names, others)


def surfel_terms(outputs: SurfelOutputs, target: Target, config: TrainConfig, regularised: bool = True) -> Terms:
    """Return the terms of L_2D: the photograph, the silhouette and, if `regularised`, the surface's smoothness."""
    terms: Terms = {"surfels.photo": _own_photo(outputs.color, target, config, target.off_edge)}
    terms |= _silhouette("surfels", outputs.alpha, target, config.surfels.alpha_weight, config, target.off_edge)
    if regularised:
        terms |= surface_terms(outputs, target, target.color, target.covered(outputs.alpha), config)
    return terms


def gaussian_terms(
    outputs: GaussianOutputs, target: Target, config: TrainConfig, covered: Tensor | None = None
) -> Terms:
    """Return the terms of L_3D: the photograph, the silhouette, and the transmitted colour's smoothness.

    covered [H,W]: what `target.covered` says of the alpha, where that is known already.
    """
    settings, depth_tv_weight = config.gaussians, config.paper.gaussian_depth_tv_weight
    terms: Terms = {"gaussians.photo": _own_photo(outputs.color, target, config, clip=True)}
    terms |= _silhouette("gaussians", outputs.alpha, target, settings.alpha_weight, config)
    if config.paper.tv and (settings.transmitted_tv_weight or depth_tv_weight):
        covered = target.covered(outputs.alpha) if covered is None else covered
    if config.paper.tv and settings.transmitted_tv_weight:
        # With masks only inside: the step to a random background is no texture to smooth away.
        inside = None if target.invalid is None else target.valid_weights(torch.ones_like(outputs.alpha))
        inside = inside if target.alpha is None else covered
        tv = edge_aware_tv_term(outputs.transmitted, target.color, mask=inside)
        terms["gaussians.transmitted_tv"] = settings.transmitted_tv_weight * tv
    if settings.reflected_cost and outputs.own_reflected is not None and outputs.weight is not None:
        # The light is never negative, so its mean is its L1 norm.
        added = product_term(outputs.weight, outputs.own_reflected)
        terms["gaussians.reflected_cost"] = settings.reflected_cost * target.share * added
    if config.paper.tv and depth_tv_weight:
        tv = edge_aware_tv_term(_rendered(outputs.depth), target.color, mask=covered)
        terms["gaussians.depth_tv"] = depth_tv_weight * tv
    return terms


def mutual_terms(surfels: SurfelOutputs, gaussians: GaussianOutputs, target: Target, config: TrainConfig) -> Terms:
    """Return the terms of L_total in the mutual phase, times the branches' weights.

    The 2D branch's target is the photograph and the 3D branch's transmitted image, which also guides its smoothness;
    the two depths pull at each other. Taught one way, the transmitted image and the surface's depth stay as they are.
    """
    settings, both = config.mutual, config.paper.teaching is Teaching.BOTH_WAYS
    transmitted = gaussians.transmitted if both else gaussians.transmitted.detach()
    where, on_surfels, on_gaussians = target.off_edge, target.covered(surfels.alpha), target.covered(gaussians.alpha)
    of_surfels: Terms = {
        "surfels.photo": settings.photo_weight * _own_photo(surfels.color, target, config, where),
        "surfels.transmitted": (1 - settings.photo_weight) * _photo(surfels.color, transmitted, target, config, where),
    }
    of_surfels |= _silhouette("surfels", surfels.alpha, target, config.surfels.alpha_weight, config, where)
    of_surfels |= surface_terms(surfels, target, gaussians.transmitted, on_surfels, config)
    terms = {name: settings.surfel_weight * term for name, term in of_surfels.items()}
    for name, term in gaussian_terms(gaussians, target, config, on_gaussians).items():
        terms[name] = settings.gaussian_weight * term
    if settings.depth_weight:
        full_depth, depth = _rendered(gaussians.depth), surface_depth(surfels, config)
        unit = depth_unit(config.paper.depth_unit, full_depth, target.distance)
        agreement = depth_agreement(full_depth, depth if both else depth.detach(), (on_surfels, on_gaussians), unit)
        terms["mutual.depth"] = settings.depth_weight * target.share * agreement
    return terms


def surface_terms(outputs: SurfelOutputs, target: Target, guide: Tensor, covered: Tensor, config: TrainConfig) -> Terms:
    """Return the surface's regularisers: lambda_3 (L_n + lambda_4 TV(N)) + lambda_5 TV(depth), and 2DGS's distortion.

    guide [H,W,3]: the image that guides the smoothness; covered [H,W]: where the surface counts, 0 or 1. The distortion
    is left out where it has no weight.
    """
    settings, depth = config.surfels, surface_depth(outputs, config)
    terms: Terms = {}
    if settings.normal_weight:
        agreement = normal_agreement_term(outputs.normal, depth, target.camera, outputs.alpha, covered)
        terms["surfels.normal"] = settings.normal_weight * agreement
    if config.paper.tv and settings.normal_weight * settings.normal_tv_weight:
        tv = edge_aware_tv_term(outputs.normal, guide, mask=covered)
        terms["surfels.normal_tv"] = settings.normal_weight * settings.normal_tv_weight * tv
    if config.paper.tv and settings.depth_tv_weight:
        terms["surfels.depth_tv"] = settings.depth_tv_weight * edge_aware_tv_term(depth, guide, mask=covered)
    if config.paper.distortion_weight and outputs.distortion is not None:
        terms["surfels.distortion"] = config.paper.distortion_weight * target.share * outputs.distortion.mean()
    return terms


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


def silhouette_loss(alpha: Tensor, mask: Tensor, kind: AlphaLoss, where: Tensor | None = None) -> Term:
    """Return the silhouette loss of the rendered alpha [H,W] against the photograph's mask [H,W], both 0..1.

    kind: the mean absolute difference or the cross entropy. where [H,W]: weights of the pixels, all 1 by default (the
    mean stays over all pixels). Gradients flow to alpha.
    """
    return silhouette_term(alpha, mask, where, entropy=kind is AlphaLoss.BCE)


def depth_agreement(
    gaussian_depth: Tensor, surfel_depth: Tensor, covered: tuple[Tensor, Tensor], unit: float | Tensor
) -> Term:
    """Return L_depth: the mean over all pixels of ((depth_3D - depth_2D) / unit)^2 where both branches cover.

    gaussian_depth, surfel_depth [H,W]: camera z; gradients flow to both. covered: a mask [H,W] of each branch, 0 or 1.
    """
    return squares_term(gaussian_depth, surfel_depth, covered, by=gaussian_depth.numel() * unit**2)


def depth_unit(kind: DepthUnit, gaussian_depth: Tensor, distance: float) -> float | Tensor:
    """Return the unit that `depth_agreement` divides by: the camera's distance from the scene's centre.

    As in the paper, it may instead be the largest value of gaussian_depth [H,W]. Both branches share it, so equal
    depths remain equal after the division. A distance below 0.1 counts as 0.1, which bounds the weight of a camera in
    the middle of the scene (radius 1).
    """
    return (
        max(distance, LEAST_DISTANCE) if kind is DepthUnit.DISTANCE else gaussian_depth.detach().max().clamp(min=1e-6)
    )


def surface_depth(outputs: SurfelOutputs, config: TrainConfig) -> Tensor:
    """Return the depth [H,W] that counts as the surface: the expected or the median one, as the settings say."""
    return outputs.depth if config.paper.surface_depth is SurfaceDepth.EXPECTED else outputs.median_depth


def _own_photo(
    image: Tensor, target: Target, config: TrainConfig, where: Tensor | None = None, clip: bool = False
) -> Term:
    """Return the photometric term of an image [H,W,3] against the target's photograph; see `_photo`."""
    return _photo(image, target.color_beside(image.clamp(max=1) if clip else image), target, config, where, clip)


def _photo(
    image: Tensor, other: Tensor, target: Target, config: TrainConfig, where: Tensor | None = None, clip: bool = False
) -> Term:
    """Return the photometric term of an image [H,W,3] against another.

    where [H,W]: the target's `off_edge`, or None for all pixels; clip: as for `image_loss`.
    """
    if clip and target.invalid is not None:  # values filled in at unknown pixels must be clipped too
        image = image.clamp(max=1)
    image, other = target.compared(image, other)
    known_sum = None if where is None else target.off_edge_sum
    share = target.share if where is None else target.off_edge_share
    return share * image_loss_term(image, other, config.l1_weight, where, clip, known_sum)


def _rendered(depth: Tensor | None) -> Tensor:
    """Return a depth map [H,W] that the stage rendered."""
    assert depth is not None, "the stage did not render depth"
    return depth


def _silhouette(
    branch: str, alpha: Tensor, target: Target, weight: float, config: TrainConfig, where: Tensor | None = None
) -> Terms:
    """Return the silhouette term of alpha [H,W]; no term without a mask or a weight."""
    if target.alpha is None or not weight:
        return {}
    alpha, mask = target.compared(alpha, target.alpha)
    return {f"{branch}.alpha": weight * target.share * silhouette_loss(alpha, mask, config.paper.alpha_loss, where)}
