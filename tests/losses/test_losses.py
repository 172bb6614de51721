"""The losses against plain numpy, and the objectives' make-up."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from torch import Tensor

from mgsr.config import AlphaLoss, DepthUnit, TrainConfig, make_config
from mgsr.data.camera import Camera
from mgsr.losses.objective import (
    depth_agreement,
    depth_unit,
    gaussian_terms,
    mutual_terms,
    silhouette_loss,
    surfel_terms,
    total,
)
from mgsr.losses.target import Target
from mgsr.ops.depth_normals import normal_agreement_term
from mgsr.ops.terms import Term, scalar
from mgsr.renderers.outputs import GaussianOutputs, SurfelOutputs

SIZE = 16
CAMERA = Camera(np.array([[20.0, 0, 8], [0, 20.0, 8], [0, 0, 1]]), np.eye(4), SIZE, SIZE)
STATS = SimpleNamespace()


def random(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed)).requires_grad_()


def surfels() -> SurfelOutputs:
    image, alpha = random(SIZE, SIZE, 3), torch.full((SIZE, SIZE), 0.9, requires_grad=True)
    depths = random(SIZE, SIZE, seed=1), random(SIZE, SIZE)
    return SurfelOutputs(image, alpha, *depths, random(SIZE, SIZE, 3), None, STATS)


def gaussians() -> GaussianOutputs:
    image, alpha = random(SIZE, SIZE, 3, seed=2), torch.full((SIZE, SIZE), 0.8, requires_grad=True)
    depth = random(SIZE, SIZE, seed=4)
    return GaussianOutputs(image, random(SIZE, SIZE, 3, seed=3), None, None, depth, alpha, STATS)


def of_images(term: Term | Tensor) -> Term:
    """Return a term that the kernels differentiate."""
    assert isinstance(term, Term)
    return term


def target(masked: bool = True) -> Target:
    return Target(random(SIZE, SIZE, 3, seed=5).detach(), torch.ones(SIZE, SIZE) if masked else None, CAMERA)


def test_depths_agree() -> None:
    covered = torch.zeros(4, 4)
    covered[1, 2] = 1
    first, second = torch.full((4, 4), 3.0), torch.full((4, 4), 2.0)
    assert float(depth_agreement(first, second, (covered, torch.ones(4, 4)), 2.0)) == pytest.approx(0.25 / 16)
    assert float(depth_agreement(first, first, (covered, covered), 2.0)) == 0.0


def test_depth_units() -> None:
    depth = torch.tensor([[1.0, 7.0]])
    assert depth_unit(DepthUnit.DISTANCE, depth, 3.0) == 3.0
    assert float(depth_unit(DepthUnit.MAXIMUM, depth, 3.0)) == 7.0
    assert float(depth_unit(DepthUnit.MAXIMUM, 0 * depth, 3.0)) > 0


def test_normals_of_a_tilted_plane_agree_with_its_depth() -> None:
    normal = torch.tensor([0.3, 0.2, -1.0])
    normal /= normal.norm()
    rows, columns = torch.meshgrid(torch.arange(SIZE) + 0.5, torch.arange(SIZE) + 0.5, indexing="ij")
    rays = torch.stack([(columns - 8) / 20, (rows - 8) / 20, torch.ones(SIZE, SIZE)], dim=-1)
    depth = float(normal @ torch.tensor([0.0, 0.0, 2.0])) / (rays @ normal)
    alpha, covered = torch.ones(SIZE, SIZE), torch.zeros(SIZE, SIZE)
    covered[2:-2, 2:-2] = 1
    agreeing = normal.expand(SIZE, SIZE, 3)
    assert float(normal_agreement_term(agreeing, depth, CAMERA, alpha, covered)) == pytest.approx(0, abs=1e-3)
    assert float(normal_agreement_term(-agreeing, depth, CAMERA, alpha, covered)) == pytest.approx(2, abs=1e-3)
    assert float(normal_agreement_term(agreeing, depth, CAMERA, alpha, 0 * covered)) == 0.0


@pytest.mark.parametrize("kind", AlphaLoss)
def test_silhouettes(kind: AlphaLoss) -> None:
    mask = torch.zeros(4, 4)
    mask[:2] = 1
    assert float(silhouette_loss(mask, mask, kind)) < 1e-3
    assert float(silhouette_loss(1 - mask, mask, kind)) > 0.9


def test_a_term_without_weight_is_not_computed() -> None:
    config = make_config(overrides=["tv=off", "surfels.alpha_weight=0", "normal_weight=0"]).train
    assert set(surfel_terms(surfels(), target(), config)) == {"surfels.photo"}
    config = make_config(overrides=["tv=off"]).train
    assert set(gaussian_terms(gaussians(), target(masked=False), config)) == {"gaussians.photo"}
    unregularised = surfel_terms(surfels(), target(), TrainConfig(), regularised=False)
    assert set(unregularised) == {"surfels.photo", "surfels.alpha"}


@pytest.mark.parametrize("branch", ["surfels", "gaussians"])
def test_a_clipped_pixel_pulls_no_brighter_rendering(branch: str) -> None:
    config = make_config(overrides=["tv=off", "l1_weight=1"]).train
    photo, clipped = torch.full((SIZE, SIZE, 3), 0.6), torch.zeros(SIZE, SIZE, 3, dtype=torch.bool)
    clipped[:, 8:] = True
    shown = torch.full((SIZE, SIZE, 3), 0.7)
    shown[:4] = 0.5
    given = replace(target(masked=False), color=photo, clipped=clipped)
    shown.requires_grad_()
    if branch == "surfels":
        terms = surfel_terms(replace(surfels(), color=shown), given, config)
    else:
        terms = gaussian_terms(replace(gaussians(), color=shown), given, config)
    (gradient,) = torch.autograd.grad(scalar(of_images(terms[f"{branch}.photo"])), shown)
    assert (gradient[4:, 8:] == 0).all(), "brighter than the clipped photograph"
    assert (gradient[:4] < 0).all(), "darker, clipped or not"
    assert (gradient[4:, :8] > 0).all(), "brighter than an unclipped photograph"


@pytest.mark.parametrize("teaching", ["both_ways", "one_way"])
def test_who_is_taught(teaching: str) -> None:
    """Check that one way the 2D branch's terms leave C_tran alone, and the depth loss the 2D branch's depth."""
    config = make_config(overrides=[f"teaching={teaching}", "surface_depth=expected"]).train
    flat, full = surfels(), gaussians()
    terms = mutual_terms(flat, full, target(), config)
    by_image = torch.autograd.grad(
        scalar(of_images(terms["surfels.transmitted"])), full.transmitted, retain_graph=True, allow_unused=True
    )
    depth = of_images(terms["mutual.depth"])
    by_depth = torch.autograd.grad(scalar(depth), flat.depth, retain_graph=True, allow_unused=True)
    assert (by_image[0] is not None) == (by_depth[0] is not None) == (teaching == "both_ways")
    assert full.depth is not None
    assert torch.autograd.grad(scalar(depth), full.depth)[0].abs().sum() > 0


def test_the_total_is_the_weighted_sum() -> None:
    """Check that weights 0.5, 0.5, 0.01 and lambda_6 act on the terms as in Algorithm 2."""
    flat, full = surfels(), gaussians()
    base = make_config(overrides=["photo_weight=0.8"]).train
    terms = mutual_terms(flat, full, target(), base)
    alone = surfel_terms(flat, target(), base)
    assert float(terms["surfels.photo"]) == pytest.approx(0.5 * 0.8 * float(alone["surfels.photo"]), rel=1e-5)
    assert float(total(terms).value) == pytest.approx(sum(float(term) for term in terms.values()), rel=1e-5)
    doubled = replace(base, mutual=replace(base.mutual, surfel_weight=1.0, depth_weight=0.02))
    again = mutual_terms(flat, full, target(), doubled)
    for name in ("surfels.photo", "surfels.transmitted", "surfels.normal", "surfels.depth_tv", "mutual.depth"):
        assert float(again[name]) == pytest.approx(2 * float(terms[name]), rel=1e-5)
    assert float(again["gaussians.photo"]) == pytest.approx(float(terms["gaussians.photo"]), rel=1e-5)


def test_coverage_wants_both_the_mask_and_the_rendering() -> None:
    alpha = torch.tensor([[0.9, 0.9, 0.1]])
    masked = Target(torch.zeros(1, 3, 3), torch.tensor([[1.0, 0.0, 1.0]]), CAMERA)
    assert masked.covered(alpha).tolist() == [[1.0, 0.0, 0.0]]
    assert replace(masked, alpha=None).covered(alpha).tolist() == [[1.0, 1.0, 0.0]]


@pytest.mark.parametrize("kind", AlphaLoss)
@pytest.mark.parametrize("masked", [True, False])
def test_unknown_pixels_teach_nothing(masked: bool, kind: AlphaLoss) -> None:
    """Check that losses and gradients are the same whatever stands at invalid pixels.

    Colour and alpha get no gradient there; far from them, beyond any window, the gradients are those of a photograph
    that shows all.
    """
    config = make_config(overrides=[f"alpha_loss={kind}"]).train
    config = replace(config, gaussians=replace(config.gaussians, transmitted_tv_weight=0.0))
    invalid = torch.arange(SIZE) * SIZE + 1  # the second column
    results = []
    for seed in (6, 7):
        photograph = target(masked)
        color = photograph.color.flatten(0, 1).index_copy(0, invalid, random(SIZE, 3, seed=seed).detach())
        photograph = replace(photograph, color=color.view(SIZE, SIZE, 3), invalid=invalid)
        results.append(_gradients(photograph, config))
    assert results[0][0] == results[1][0]
    for one, other in zip(results[0][1], results[1][1], strict=True):
        assert torch.equal(one, other)
        assert not one.flatten(0, 1)[invalid].any()
    _, whole = _gradients(target(masked), config)
    for one, other in zip(results[0][1], whole, strict=True):
        torch.testing.assert_close(one[:, 12:], other[:, 12:])
        assert other.flatten(0, 1)[invalid].any()


def _gradients(photograph: Target, config: TrainConfig) -> tuple[list[float], list[torch.Tensor]]:
    """Return the terms, and the gradients of both branches' colours and, with masks, their alphas."""
    flat, full = surfels(), gaussians()
    loss = total(mutual_terms(flat, full, photograph, config))
    wanted = [flat.color, full.color, *([] if photograph.alpha is None else [flat.alpha, full.alpha])]
    return [float(term) for term in loss.terms.values()], list(torch.autograd.grad(loss.value, wanted))
