"""How far masks contradict each other, on spheres with exact, binary and rough masks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

from mgsr.config.expert import DataOptions, MaskErrorOptions
from mgsr.data.mask_error import find_mask_errors, mask_error, with_mask_error
from mgsr.data.readers import load_scene
from mgsr.data.scene import Scene, View
from mgsr.data.silhouettes import signed_distance
from mgsr.export.scenes import write_scene
from mgsr.inspection.findings import Code, Finding
from mgsr.inspection.photo_check import check_masks
from tests.cli.spheres import write_spheres
from tests.optional import present


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """Provide three spheres with exact masks."""
    return load_scene(write_spheres(tmp_path_factory.mktemp("capture") / "spheres", size=96, train=24))


def with_errors(scene: Scene, deviation: float) -> list[View]:
    """Return the training views with binary masks whose contours err by so many pixels, alike over about five."""
    draw, views = np.random.default_rng(0), []
    for view in scene.train:
        distance = signed_distance(present(view.alpha) / 255)
        noise = ndimage.gaussian_filter(draw.standard_normal(distance.shape), 5.0)
        mask = distance + deviation * noise / noise.std() > 0
        views.append(replace(view, alpha=(255 * mask).astype(np.uint8)))
    return views


def test_it_is_small_for_exact_and_binary_masks_and_grows_with_errors(scene: Scene) -> None:
    exact, binary, half, whole = mask_error(scene.train), *(mask_error(with_errors(scene, d)) for d in (0, 0.5, 1))
    assert abs(exact) < 0.05 and abs(binary) < 0.1
    assert 0.1 < half < 0.5 * whole and 0.5 < whole < 1.5


def test_it_shows_poses_that_do_not_fit(scene: Scene) -> None:
    draw, views = np.random.default_rng(0), []
    for view in scene.train:
        K = view.camera.K.copy()
        K[:2, 2] += draw.normal(0, 1.5, 2)
        views.append(replace(view, camera=replace(view.camera, K=K)))
    assert mask_error(views) > 0.6


def test_no_contour_is_in_sight(scene: Scene) -> None:
    full = [replace(view, alpha=np.full_like(present(view.alpha), 255)) for view in scene.train]
    assert mask_error(full) == 0


@pytest.mark.parametrize(("deviation", "inexact"), [(0.0, False), (1.0, True)])
def test_a_scene_knows_of_its_masks(scene: Scene, tmp_path: Path, deviation: float, inexact: bool) -> None:
    write_scene(tmp_path, replace(scene, train=with_errors(scene, deviation)), 1.0)
    read = with_mask_error(load_scene(tmp_path))
    assert read.masks_inexact == inexact and read.mask_margin == (read.mask_error if inexact else 0)
    assert read.mask_dissent == 0 and not read.masks_found
    assert any("contours of the masks contradict each other" in note for note in read.notes) == inexact
    tolerant = with_mask_error(load_scene(tmp_path, options=DataOptions(mask_error=MaskErrorOptions(exact=5))))
    assert not tolerant.masks_inexact and tolerant.mask_margin == 0


def with_bites(scene: Scene, numbers: Sequence[int]) -> Scene:
    """Return the scene with a disc cut out of some masks, at the top of the object."""
    train = list(scene.train)
    for number in numbers:
        mask = present(train[number].alpha).copy()
        rows, columns = np.nonzero(mask > 127)
        y, x = np.mgrid[: mask.shape[0], : mask.shape[1]]
        mask[np.hypot(y - rows.min(), x - np.median(columns[rows == rows.min()])) < 14] = 0
        train[number] = replace(train[number], alpha=mask)
    return replace(scene, train=train)


def test_masks_that_miss_a_part_are_left_out(scene: Scene) -> None:
    bitten = with_bites(scene, (4, 15))
    assert find_mask_errors(scene.train)[0] == [] and find_mask_errors(bitten.train)[0] == [4, 15]
    measured = with_mask_error(bitten)
    names = [bitten.train[number].name for number in (4, 15)]
    assert [view.name for view in measured.train] == [view.name for view in scene.train if view.name not in names]
    assert any(all(repr(name) in note for name in names) and "are skipped" in note for note in measured.notes)


def test_a_camera_that_looks_away_contradicts_all_others(scene: Scene) -> None:
    """Check that a camera with the object behind it is measured, too. The reading leaves such views out."""
    pose = np.diag([-1.0, 1, -1, 1]) @ scene.train[3].camera.cam_from_world
    away = replace(scene.train[3], camera=replace(scene.train[3].camera, cam_from_world=pose))
    assert mask_error([*scene.train[:3], away, *scene.train[4:]]) > 3


def test_rough_masks_are_not_incomplete(scene: Scene) -> None:
    assert find_mask_errors(with_errors(scene, 1.0))[0] == []


def test_none_is_left_out_where_many_miss_a_part(scene: Scene) -> None:
    assert find_mask_errors(with_bites(scene, range(0, 24, 3)).train)[0] == []


def mask_findings(scene: Scene) -> dict[Code, Finding]:
    """Return what the inspection finds about the masks of a scene."""
    return {each.code: each for each in check_masks(scene, [view.name for view in scene.train])}


def test_an_inspection_tells_of_both(scene: Scene) -> None:
    assert mask_findings(scene) == {}
    bitten = with_bites(scene, (4, 15))
    assert mask_findings(bitten)[Code.CONTRADICTORY_MASK].photographs == tuple(bitten.train[i].name for i in (4, 15))
    rough = replace(scene, train=with_errors(scene, 1.0))
    assert 0.5 < mask_findings(rough)[Code.INEXACT_MASKS].amount < 1.5
    known = with_mask_error(rough)
    assert mask_findings(known)[Code.INEXACT_MASKS].amount == pytest.approx(known.mask_margin, abs=0.005)
