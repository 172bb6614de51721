"""The parts that segmentation is made of, each against an independent witness."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy import ndimage

from mgsr.config.expert import (
    ColorModelOptions,
    MatteOptions,
    RandomWalkerOptions,
    SupportPlaneOptions,
    TolerantHullOptions,
)
from mgsr.data.camera import Camera
from mgsr.data.hull import hull_surface
from mgsr.data.scene import View
from mgsr.gaussians.start import SH_CONSTANT
from mgsr.gaussians.surfels import SurfelModel
from mgsr.geometry.mesh import Mesh
from mgsr.geometry.raycast import pixel_rays
from mgsr.renderers.surfels import render_surfels
from mgsr.segmentation.background import BackgroundSources, squared_difference
from mgsr.segmentation.color_models import color_models, near_on_plane
from mgsr.segmentation.consensus import silhouette_distance, tolerant_hull
from mgsr.segmentation.mattes import first_region, hull_region, matte, without_small_holes
from mgsr.segmentation.random_walker import random_walker
from mgsr.segmentation.splat_labels import lifted_sums, pieces, some_surfels
from mgsr.segmentation.support_plane import SupportPlane, find_support_plane, upward
from tests.segmentation.table_scene import TABLE, table_scene


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


def test_lifted_sums_are_the_masks_weighted_by_the_surfels_shares() -> None:
    """Check the derivatives against renderings of one surfel's label after another."""
    model, seen = surfels(12), cameras()[:2]
    masks = [np.random.default_rng(i).random((camera.height, camera.width, 3)) for i, camera in enumerate(seen)]
    sums = lifted_sums(model, masks, seen)
    for index in range(len(model)):
        shares = [shares_of(model, index, camera) for camera in seen]
        inside = sum((share[..., None] * mask).sum(axis=(0, 1)) for share, mask in zip(shares, masks, strict=True))
        assert sums[index] == pytest.approx(inside, rel=1e-3, abs=1e-3)


def shares_of(model: SurfelModel, index: int, camera: Camera) -> np.ndarray:
    """Render one surfel's share of each pixel, [H,W], behind and before the others."""
    color = torch.zeros(len(model), 1, 3)
    color[index], others = 0.5 / SH_CONSTANT, torch.arange(len(model)) != index
    color[others] = -0.5 / SH_CONSTANT
    return render_surfels(replace(model, sh=color), camera, torch.zeros(3), 0).color[..., 0].numpy()


def test_some_surfels_are_a_model_of_their_own() -> None:
    model, chosen = surfels(6), np.array([0, 1, 0, 0, 1, 1], bool)
    part = some_surfels(model, chosen)
    assert len(part) == 3
    torch.testing.assert_close(part.means, model.means[[1, 4, 5]])
    torch.testing.assert_close(part.sh, model.sh[[1, 4, 5]])


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


def test_a_steeper_plane_may_be_allowed() -> None:
    flat = np.column_stack([np.random.default_rng(0).uniform(-1.5, 1.5, (2000, 2)), np.full(2000, -0.8)])
    tilt = np.radians(50)
    points = flat @ np.array([[1, 0, 0], [0, np.cos(tilt), np.sin(tilt)], [0, -np.sin(tilt), np.cos(tilt)]])
    generator, steep = np.random.default_rng(1), SupportPlaneOptions(max_tilt=80.0, min_above=0.0)
    assert find_support_plane(points, cameras(), 0.02, generator) is None
    plane = find_support_plane(points, cameras(), 0.02, generator, steep)
    assert plane is not None and np.degrees(np.arccos(plane.normal[2])) == pytest.approx(50, abs=0.5)


def test_without_smoothness_each_pixel_decides_for_itself() -> None:
    as_background, as_object = np.random.default_rng(0).random((2, 7, 9)) * 3
    whole, options = np.ones((7, 9), bool), RandomWalkerOptions(smoothness=0.0)
    shares = random_walker(np.zeros((7, 9, 3), np.float32), as_background, as_object, whole, options)
    np.testing.assert_allclose(shares, as_background / (as_background + as_object), atol=1e-4)


def test_regions_reach_as_far_as_they_are_told() -> None:
    mask, distance = np.zeros((40, 40), bool), np.full((40, 40), -30.0)
    mask[18:22, 18:22], distance[10:30, 10:30] = True, -8.0
    assert first_region(mask, MatteOptions(first_searched=2.0)).sum() > 4 * first_region(mask).sum()
    assert not hull_region(mask, distance)[~mask].any() and hull_region(mask, distance)[mask].all()
    assert hull_region(mask, distance, MatteOptions(searched=9.0))[10:30, 10:30].all()


def test_shares_solve_the_random_walkers_equations() -> None:
    """Check the minimum against a dense solution of the same weighted graph, edge by edge."""
    random = np.random.default_rng(0)
    usual = RandomWalkerOptions()
    image, region = random.random((7, 9, 3)).astype(np.float32), np.zeros((7, 9), bool)
    region[1:6, 2:8] = True
    as_background, as_object = random.random((2, 7, 9)) * 3
    matrix, right = np.zeros((63, 63)), np.zeros(63)
    for row, column in np.ndindex(7, 9):
        here = 9 * row + column
        if not region[row, column]:
            matrix[here, here] = 1
            continue
        matrix[here, here] += as_background[row, column] + as_object[row, column]
        right[here] = as_background[row, column]
        for down, across in np.ndindex(3, 3):
            r, c = row + down - 1, column + across - 1
            if (r, c) != (row, column):
                difference = float(((image[row, column] - image[r, c]) ** 2).sum())
                weight = (
                    usual.smoothness * np.exp(-difference / (2 * usual.contrast**2)) / np.hypot(r - row, c - column)
                )
                matrix[here, here] += weight
                matrix[here, 9 * r + c] -= weight
    expected = np.linalg.solve(matrix, right).reshape(7, 9)
    shares = random_walker(image, as_background, as_object, region)
    np.testing.assert_allclose(shares, expected, atol=5e-3)
    assert not random_walker(image, as_background, as_object, np.zeros((7, 9), bool)).any()


def test_the_background_behind_the_object_is_what_other_photographs_show() -> None:
    """Check it against the same table without the object, as a ray tracer shows it."""
    (scene, truth), (empty, _) = table_scene(size=96), table_scene(size=96, copies=0)
    seen = [view.camera for view in scene.train]
    masks = truth[: len(seen)]
    clear = [255 * (~mask).astype(np.uint8) for mask in masks]
    plane = SupportPlane(np.array([0.0, 0.0, 1.0]), -TABLE)
    sources = BackgroundSources(scene.train, clear, surfels(0), plane)
    for index in (0, 1, 2):
        rays, center = pixel_rays(seen[index]), seen[index].center
        places = center + (TABLE - center[2]) / np.minimum(rays[..., 2:], -1e-9) * rays
        asked = masks[index] & (rays[..., 2] < 0) & (np.linalg.norm(places[..., :2], axis=-1) < 1.7)
        found = sources.expected(scene.train[index], (slice(None), slice(None)), asked)
        assert not (found.known & ~asked).any() and found.known[asked].mean() > 0.6
        wrong = np.abs(found.color - empty.train[index].image / 255).max(axis=-1)[found.known]
        assert np.median(wrong) < 0.03 and (wrong < 0.1).mean() > 0.9


def test_photo_consistency_tells_table_from_object_where_no_photograph_is_clear() -> None:
    scene, truth = table_scene(size=96)
    seen = [view.camera for view in scene.train]
    plane = SupportPlane(np.array([0.0, 0.0, 1.0]), -TABLE)
    unclear = [np.zeros(view.image.shape[:2], np.uint8) for view in scene.train]
    sources = BackgroundSources(scene.train, unclear, surfels(0), plane)
    on_table, on_object = [], []
    for index in range(0, len(seen), 4):
        rays, center = pixel_rays(seen[index]), seen[index].center
        places = center + (TABLE - center[2]) / np.minimum(rays[..., 2:], -1e-9) * rays
        asked = (rays[..., 2] < 0) & (np.linalg.norm(places[..., :2], axis=-1) < 1.2)
        found = sources.expected(scene.train[index], (slice(None), slice(None)), asked)
        assert not found.known.any() and np.isinf(found.behind[~asked]).all()
        differs = np.where(
            np.isfinite(found.above), found.behind - np.where(np.isfinite(found.above), found.above, 0), 0
        )
        asked &= np.isfinite(differs) & np.isfinite(found.above)
        apart = ndimage.binary_erosion(truth[index], iterations=2), ndimage.binary_dilation(truth[index], iterations=2)
        on_object.append(differs[asked & apart[0]])
        on_table.append(differs[asked & ~apart[1]])
    assert (np.concatenate(on_table) < 0.002).mean() > 0.95
    assert (np.concatenate(on_object) > 0.002).mean() > 0.6


def painted(color: float, white: int | None = None) -> tuple[list[View], list[np.ndarray]]:
    """Return the views of the table's capture with the object in one grey, sRGB 0..1, and its true masks."""
    scene, truth = table_scene(size=96)
    grey = np.uint8(round(255 * color))
    clips = None if white is None else np.full(3, white, np.uint8)
    views = [
        replace(view, image=np.where(mask[..., None], grey, view.image), white=clips)
        for view, mask in zip(scene.train, truth, strict=False)
    ]
    return views, truth[: len(views)]


def grey_surfels(color: float) -> SurfelModel:
    """Return opaque surfels in one grey, sRGB 0..1, in the middle of the table's object."""
    model = surfels(200)
    model.sh[:, 0] = (color - 0.5) / SH_CONSTANT
    return replace(model, opacity_logits=torch.full((200,), 4.0))


def errors(
    views: list[View],
    truth: list[np.ndarray],
    sources: BackgroundSources,
    model: SurfelModel,
    options: MatteOptions = MatteOptions(),
) -> float:
    """Return the share of wrong pixels in and around the object in some mattes."""
    wrong = []
    for index in range(0, len(views), 6):
        region = ndimage.binary_dilation(truth[index], iterations=6)
        found = matte(views[index], region, model, sources, options=options)
        wrong.append(((found.share > 0.5) != truth[index])[region].mean())
    return float(np.mean(wrong))


def test_a_clipped_photograph_shows_the_object_even_where_its_surfels_are_brighter() -> None:
    plane = SupportPlane(np.array([0.0, 0.0, 1.0]), -TABLE)
    found = []
    for white in (222, None):
        views, truth = painted(222 / 255, white)
        clear = [255 * (~ndimage.binary_dilation(mask)).astype(np.uint8) for mask in truth]
        sources = BackgroundSources(views, clear, surfels(0), plane)
        found.append(errors(views, truth, sources, grey_surfels(1.4)))
    assert found[0] < 0.03 and found[1] > 10 * found[0], found


def test_a_background_of_unknown_colour_explains_no_pixel_well() -> None:
    random = np.random.default_rng(0)
    views, truth = painted(0.75)
    noise = [replace(view, image=random.integers(0, 256, view.image.shape).astype(np.uint8)) for view in views]
    clear = [np.full(mask.shape, 255, np.uint8) for mask in truth]
    sources = BackgroundSources(noise, clear, surfels(0), SupportPlane(np.array([0.0, 0.0, 1.0]), -TABLE))
    model = grey_surfels(0.68)  # less than two standard deviations from the photographs
    without = errors(views, truth, sources, model, MatteOptions(unsure=0))
    assert errors(views, truth, sources, model) < without / 3


def test_a_gap_that_the_hull_fills_shows_the_background() -> None:
    """Check a gap that reaches the rim, and the object in the background's colour, which is no gap."""
    views, truth = painted(0.75)
    view, mask = views[0], truth[0]
    rows, columns = np.nonzero(mask)
    row, left, right = int(np.median(rows)), columns[rows == int(np.median(rows))].min(), columns.max()
    image, gap = view.image.copy(), np.zeros_like(mask)
    gap[row - 3 : row + 4, left : left + (right - left) // 3] = True
    gap &= mask
    spot = ndimage.binary_erosion(mask, iterations=5) & ~ndimage.binary_dilation(gap, iterations=5)
    image[gap | spot] = 176
    behind = [replace(other, image=np.full_like(other.image, 176)) for other in views]
    clear = [np.full(each.shape, 255, np.uint8) for each in truth]
    sources = BackgroundSources(behind, clear, surfels(0), SupportPlane(np.array([0.0, 0.0, 1.0]), -TABLE))
    inside = ndimage.distance_transform_edt(mask) - ndimage.distance_transform_edt(~mask)
    region = ndimage.binary_dilation(mask, iterations=6)
    found = matte(replace(view, image=image), region, grey_surfels(0.75), sources, inside)
    spot, gap = spot & found.background_known, ndimage.binary_erosion(gap) & found.background_known
    assert spot.sum() > 50 and gap.sum() > 20
    assert found.gaps[gap].mean() > 0.9 and not found.gaps[spot].any()
    assert (found.share > 0.5)[spot].mean() > 0.9 and (found.share > 0.5)[gap].mean() < 0.1


def test_brighter_colours_do_not_differ_from_clipped_ones() -> None:
    one, other = np.array([[0.5, 0.8, 0.8], [0.5, 0.5, 0.9]]), np.array([[0.6, 0.9, 0.7], [0.5, 0.7, 0.6]])
    high = one >= 0.8, other >= 0.7
    np.testing.assert_allclose(squared_difference(one, other, None), [0.03, 0.13])
    np.testing.assert_allclose(squared_difference(one, other, high[0]), [0.02, 0.13])
    np.testing.assert_allclose(squared_difference(one, other, None, high[1]), [0.02, 0.09 + 0.04])
    np.testing.assert_allclose(squared_difference(one, other, high[0], high[1]), [0.01, 0.13])


def test_colour_models_compare_with_the_nearest_samples() -> None:
    """Check the costs against all distances, computed one by one."""
    random = np.random.default_rng(0)
    images = [random.integers(0, 256, (12, 10, 3)).astype(np.uint8) for _ in range(2)]
    objects = [random.random((12, 10)) < 0.3 for _ in images]
    supports = [~mask for mask in objects]
    options = ColorModelOptions(samples=40_000, neighbours=3, deviation=0.1, shades=2, darkest=0.5)
    models = color_models(images, objects, supports, options)
    assert models is not None
    asked = random.random((9, 3))
    sure, plane = (
        np.concatenate([i[m] for i, m in zip(images, masks, strict=True)]) / 255 for masks in (objects, supports)
    )
    for costs, colors in zip(models.costs(asked), (sure, np.concatenate([plane, plane / 2])), strict=True):
        nearest = np.linalg.norm(asked[:, None] - colors, axis=-1).min(axis=1)  # each colour is drawn more than thrice
        np.testing.assert_allclose(costs, nearest**2 / (2 * 0.1**2), rtol=1e-4)
    assert color_models(images, [np.zeros((12, 10), bool)] * 2, supports, options) is None


def test_pixels_on_the_plane_near_a_point_are_found() -> None:
    plane, middle = SupportPlane(np.array([0.0, 0.0, 1.0]), -TABLE), np.array([0.0, 0.0, TABLE])
    ring = middle + 0.5 * np.array([[np.cos(a), np.sin(a), 0] for a in np.linspace(0, 6, 40)])
    for camera in cameras():
        near = near_on_plane(camera, plane, middle, 0.7)
        columns, rows = np.floor(camera.project(ring)[0]).astype(int).T
        assert near[rows, columns].all() and not near_on_plane(camera, plane, middle, 0.3)[rows, columns].any()
        assert not near[pixel_rays(camera)[..., 2] >= 0].any()


def test_colours_tell_table_from_object_where_no_photograph_is_clear() -> None:
    scene, truth = table_scene(size=96)
    seen, images = [view.camera for view in scene.train], [view.image for view in scene.train]
    plane = SupportPlane(np.array([0.0, 0.0, 1.0]), -TABLE)
    unclear = [np.zeros(view.image.shape[:2], np.uint8) for view in scene.train]
    sources = BackgroundSources(scene.train, unclear, surfels(0), plane)
    around = [ndimage.binary_dilation(mask, iterations=8) for mask in truth]
    inside = [ndimage.binary_erosion(mask, iterations=3) for mask in truth]
    near = [near_on_plane(camera, plane, np.array([0, 0, TABLE]), 1.5) for camera in seen]
    supports = [where & ~wide for where, wide in zip(near, around, strict=False)]
    models = color_models(images, inside[: len(seen)], supports)
    assert models is not None
    right, wrong = [], []
    for index in range(0, len(seen), 4):
        region = around[index] & near[index]  # the pillar, the lower part of the ball, and the table beside them
        clear = region & (inside[index] | ~ndimage.binary_dilation(truth[index], iterations=2))
        unlike_object, unlike_support = models.costs(images[index][clear] / np.float32(255))
        right.append(((unlike_object < unlike_support) == truth[index][clear]).mean())
        found = [
            matte(scene.train[index], region, surfels(0), sources, models=each).share > 0.5 for each in (None, models)
        ]
        wrong.append([(mask != truth[index])[region].mean() for mask in found])
    without, reported = np.mean(wrong, axis=0)
    assert np.mean(right) > 0.97 and reported < 0.9 * without, (right, without, reported)


def test_small_holes_of_a_matte_are_filled_and_large_ones_left() -> None:
    share = np.zeros((60, 60), np.float32)
    share[5:55, 5:55] = 0.9
    share[10:12, 10:13] = 0.1  # a highlight, 6 of 2500 pixels
    share[30:40, 30:40] = 0.1  # a handle's opening
    filled = without_small_holes(share)
    assert (filled[10:12, 10:13] == 1).all() and (filled[30:40, 30:40] == np.float32(0.1)).all()
    assert (np.delete(filled, np.s_[10:12], axis=0) == np.delete(share, np.s_[10:12], axis=0)).all()


def test_a_hull_that_some_masks_contradict_shows_what_they_leave_out() -> None:
    scene, truth = table_scene(size=96)
    seen = [view.camera for view in scene.train + scene.test]
    box = np.array([[-0.45, -0.45, -0.8], [0.45, 0.45, 0.65]])
    masks = [mask.astype(np.float32) for mask in truth]
    masks[2][48:, :] = 0
    plane = SupportPlane(np.array([0.0, 0.0, 1.0]), -TABLE)
    hull = tolerant_hull(masks, seen, box, plane, 0.1)
    caster = Mesh(*hull_surface(hull)).caster
    silhouettes = [silhouette_distance(caster, camera) > 0 for camera in seen]
    assert (silhouettes[2] & truth[2]).sum() > 0.97 * truth[2].sum() > 1.3 * masks[2].sum()
    for mask, true in zip(silhouettes, truth, strict=True):
        assert (mask & ~true).sum() < 0.12 * true.sum()
    places = np.argwhere(hull.field > 0) * hull.voxel + hull.origin
    assert places[:, 2].min() > TABLE - 0.05
    coarse = tolerant_hull(masks, seen, box, plane, 0.1, TolerantHullOptions(resolution=32))
    assert coarse.voxel == pytest.approx(hull.voxel * 127 / 31, rel=0.1)
