"""The parts that segmentation is made of, each against an independent witness."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from mgsr.data.camera import Camera
from mgsr.gaussians.surfels import SurfelModel
from mgsr.segmentation.consensus import completed_masks
from mgsr.segmentation.grab_cut import refined_mask, without_small_holes
from mgsr.segmentation.splat_labels import lifted_labels, pieces, rendered_labels
from mgsr.segmentation.support_plane import find_support_plane, upward
from tests.segmentation.table_scene import table_scene


def surfels(count: int, seed: int = 0) -> SurfelModel:
    """Return some surfels near the origin."""
    torch.manual_seed(seed)
    return SurfelModel(
        means=0.4 * torch.randn(count, 3),
        quats=torch.randn(count, 4),
        log_scales=torch.full((count, 2), -2.0),
        opacity_logits=torch.randn(count),
        sh=torch.zeros(count, 4, 3),
    )


def cameras() -> list[Camera]:
    """Return the cameras of the table's capture."""
    scene, _ = table_scene(size=32, views=6)
    return [view.camera for view in scene.train]


def test_lifted_labels_are_means_of_the_masks_weighted_by_the_surfels_shares() -> None:
    """Check the derivatives against renderings of one surfel's label after another."""
    model, seen = surfels(12), cameras()[:2]
    masks = [np.random.default_rng(i).random((camera.height, camera.width)) for i, camera in enumerate(seen)]
    labels, weights = lifted_labels(model, masks, seen)
    for index in range(len(model)):
        alone = (np.arange(len(model)) == index).astype(float)
        shares = rendered_labels(model, alone, seen)
        whole = sum(float(share.sum()) for share in shares)
        inside = sum(float((share * mask).sum()) for share, mask in zip(shares, masks, strict=True))
        assert weights[index] == pytest.approx(whole, rel=1e-3, abs=1e-3)
        if whole > 0.1:
            assert labels[index] == pytest.approx(inside / whole, abs=2e-3)


def test_labels_of_one_everywhere_render_to_the_opacity() -> None:
    from mgsr.renderers.surfels import render_surfels

    model, camera = surfels(40), cameras()[0]
    (share,) = rendered_labels(model, np.ones(40), [camera])
    np.testing.assert_allclose(share, render_surfels(model, camera).alpha.numpy(), atol=1e-5)


def test_pieces_are_numbered_by_their_size() -> None:
    line, up, aside = (np.array(way) for way in ([0.1, 0, 0], [0, 0, 9], [0, 5, 0]))
    steps = np.arange(5)[:, None] * line
    points = np.concatenate([steps[:2] + aside, steps, steps[:3] + up])
    assert pieces(points, 0.11).tolist() == [2, 2, 0, 0, 0, 0, 0, 1, 1, 1]


def test_a_plane_is_found_under_a_crowd_of_points() -> None:
    random = np.random.default_rng(0)
    table = np.column_stack([random.uniform(-1.5, 1.5, (2000, 2)), random.normal(-0.8, 0.005, 2000)])
    others = np.column_stack([random.normal(0, 0.3, (2500, 2)), random.uniform(-0.8, 0.6, 2500)])
    points = np.concatenate([table, others])
    plane = find_support_plane(points, cameras(), 0.02, np.random.default_rng(1))
    assert plane is not None and plane.normal @ upward(cameras()) > 0.9
    assert np.degrees(np.arccos(plane.normal[2])) < 0.3 and plane.offset == pytest.approx(0.8, abs=0.005)
    assert find_support_plane(others, cameras(), 0.02, np.random.default_rng(1)) is None
    assert find_support_plane(points * [1, 1, -1], cameras(), 0.02, np.random.default_rng(1)) is None  # hangs from it
    assert find_support_plane(points[:2], cameras(), 0.02, np.random.default_rng(1)) is None


def test_a_contour_moves_to_where_the_colours_change() -> None:
    rows, columns = np.mgrid[:80, :80]
    truth = (rows - 40) ** 2 + (columns - 38) ** 2 < 24**2
    noise = np.random.default_rng(0).normal(0, 6, (80, 80, 3))
    image = (np.where(truth[..., None], [200, 90, 60], [70, 110, 130]) + noise).clip(0, 255).astype(np.uint8)
    rough = (rows - 41) ** 2 + (columns - 40) ** 2 < 25**2
    refined = refined_mask(image, rough, 0.12)
    assert (refined ^ truth).sum() < 0.02 * truth.sum() < (rough ^ truth).sum()
    speck = np.zeros((80, 80), bool)
    speck[5, 5] = True
    assert (refined_mask(image, speck, 0.1) == speck).all()
    assert not refined_mask(image, np.zeros((80, 80), bool), 0.1).any()


def test_small_holes_are_filled_and_openings_stay() -> None:
    rows, columns = np.mgrid[:80, :80]
    ring = (rows - 40) ** 2 + (columns - 40) ** 2
    mask = (ring < 30**2) & (ring > 12**2)
    spotted = mask.copy()
    spotted[60:63, 40:43] = False
    np.testing.assert_array_equal(without_small_holes(spotted), mask)


def test_what_one_mask_leaves_out_is_completed_by_the_others() -> None:
    scene, truth = table_scene(size=96)
    seen = [view.camera for view in scene.train + scene.test]
    box = np.array([[-0.45, -0.45, -0.8], [0.45, 0.45, 0.65]])
    masks = [mask.copy() for mask in truth]
    masks[2][48:, :] = False
    completed = completed_masks(masks, seen, box)
    assert (completed[2] & truth[2]).sum() > 0.97 * truth[2].sum() > 1.3 * masks[2].sum()
    for mask, true in zip(completed, truth, strict=True):
        assert (mask & ~true).sum() < 0.06 * true.sum()
