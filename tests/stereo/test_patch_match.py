"""PatchMatch stereo, on a ball with a bowl pressed into a flat cap, begun on the ball with the cap."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from mgsr.config.expert import MatchSettings, PatchMatchOptions
from mgsr.data.scene import View
from mgsr.geometry.raycast import RayCaster, pixel_rays
from mgsr.native import _stereo
from mgsr.native.structs import StereoPlanes, StereoSettings, StereoViews
from mgsr.stereo.patch_match import DepthMap, match_views, stereo_settings, weigh, weigh_gaps
from mgsr.stereo.photographs import StereoPhotographs, stereo_photographs
from tests.ops.variants import ISAS, variant
from tests.stereo.pressed_ball import CAP, cameras_above, hull, photographs, pressed, with_noise

COUNT, SIDE = 9, 112


@pytest.fixture(scope="module")
def start() -> RayCaster:
    mesh = hull()
    return RayCaster(mesh.vertices, mesh.faces)


@pytest.fixture(scope="module")
def few() -> StereoPhotographs:
    """Return five small photographs, for what does not need a good surface."""
    return stereo_photographs(photographs(True, 0.0, cameras_above(5, 48)))


@dataclass(frozen=True)
class Found:
    """The depths found at all pixels [P] that show the object.

    They tell how far the depth lies behind the truth and behind the start, and the truth behind the start, all in
    pixels; the degrees between the normal and the true one; the weight; and whether they show what is far from the cap.
    """

    error: np.ndarray
    moved: np.ndarray
    bowl: np.ndarray
    tilt: np.ndarray
    weight: np.ndarray
    aside: np.ndarray


def find(views: list[View], start: RayCaster) -> Found:
    stereo, truth = stereo_photographs(views), RayCaster(pressed().vertices, pressed().faces)
    maps = match_views(stereo, start, seed=0)
    rows = []
    for camera, found, weight in zip(stereo.cameras, maps, weigh(stereo, maps), strict=True):
        first, seen = start.cast(camera).depth, truth.cast(camera)
        true, cosines = seen.depth, (seen.normal * found.normal).sum(axis=-1)
        heights = (camera.center + pixel_rays(camera) * first[..., None])[..., 2]
        shown = (first > 0) & (true > 0)
        pixels = camera.K[0, 0] / true[shown]
        error, moved, bowl = found.depth - true, found.depth - first, true - first
        apart = [each[shown] * pixels for each in (error, moved, bowl)]
        tilt = np.degrees(np.arccos(np.clip(cosines, -1, 1)))
        rows.append([*apart, tilt[shown], weight[shown], heights[shown] < CAP - 0.1])
    return Found(*(np.concatenate(column) for column in zip(*rows, strict=True)))


@pytest.mark.parametrize("gloss", [0.0, 0.4])
def test_the_bowl_is_found_and_the_rest_stays(gloss: float, start: RayCaster) -> None:
    found = find(photographs(True, gloss, cameras_above(COUNT, SIDE)), start)
    sure, deep = found.weight > 0, found.bowl > 2
    assert sure[deep].mean() > 0.9 and sure[found.aside].mean() > 0.65
    assert np.median(found.bowl[deep]) > 3.5
    assert (np.abs(found.error[deep & sure]) < 1).mean() > 0.75 and np.median(np.abs(found.error[deep & sure])) < 0.5
    assert np.median(found.tilt[deep & sure]) < 8
    assert (np.abs(found.moved[found.aside & sure]) < 1).mean() > 0.9
    assert np.median(np.abs(found.moved[found.aside & sure])) < 0.25


def test_one_colour_says_nothing(start: RayCaster) -> None:
    """Check that depths stay where they begin, and that what noise moves is hardly believed."""
    found = find(photographs(False, 0.0, cameras_above(COUNT, SIDE)), start)
    away = np.abs(found.moved)
    assert np.median(away) < 0.2 and np.percentile(away, 75) < 0.7
    assert np.average(away < 1, weights=found.weight) > 0.85
    assert found.weight.mean() < 0.2


def test_scores_are_what_judge_says_less_the_prior(few: StereoPhotographs, start: RayCaster) -> None:
    """Check that scores are what `judge` says less the prior, and that no plane is worse than the start's own.

    The search tries the start's plane first.
    """
    camera, shown = few.cameras[0], few.images[0][..., 3] > 0.5
    settings = MatchSettings(prior=0.2, prior_reach=0.6)
    found, seen = match_views(few, start, 0, PatchMatchOptions(settings=settings))[0], start.cast(camera)
    away = np.abs(found.depth - seen.depth)[shown] * camera.K[0, 0] / seen.depth[shown]
    lost = settings.prior * np.minimum(1, away / settings.prior_reach)
    assert (lost < 0.5 * settings.prior).sum() > 50 and (lost == settings.prior).sum() > 50
    judged = judge(few, found.depth, found.normal, settings)[shown]
    # Depth and normal come out in float32, and a step of the warp's rounding changes a sample by as much.
    np.testing.assert_allclose(found.score[shown], judged - lost, atol=2e-4)
    assert (found.score >= judge(few, seen.depth, seen.normal, settings) - 1e-5)[shown].all()


def judge(few: StereoPhotographs, depth: np.ndarray, normal: np.ndarray, settings: MatchSettings) -> np.ndarray:
    """Score [h,w] planes of the first photograph, with normals [h,w,3] of the world's frame, by all others."""
    score = np.empty(depth.shape, np.float32)
    turned = np.ascontiguousarray(normal @ few.cameras[0].cam_from_world[:3, :3].T, np.float32)
    views = StereoViews(
        images=few.images, cameras=few.packed_cameras, view=0, neighbours=[1, 2, 3, 4], range=(1.9, 4.1)
    )
    _stereo.judge(views, StereoPlanes(depth=depth, normal=turned), stereo_settings(settings), score)
    return score


def test_normals_are_unit_and_towards_the_camera(few: StereoPhotographs, start: RayCaster) -> None:
    for camera, found in zip(few.cameras, match_views(few, start, seed=0), strict=True):
        known = found.depth > 0
        assert known.sum() > 200
        np.testing.assert_allclose(np.linalg.norm(found.normal[known], axis=-1), 1, atol=1e-5)
        assert ((found.normal * pixel_rays(camera)).sum(axis=-1)[known] < 0).all()
        assert (found.normal[~known] == 0).all() and (found.score[~known] == -1).all()


@pytest.mark.parametrize("isa", ISAS)
def test_the_same_bytes_on_any_number_of_threads(few: StereoPhotographs, start: RayCaster, isa: str) -> None:
    runs = []
    for threads in (1, 2, 5):
        with variant(_stereo, isa, threads):
            runs.append(match_views(few, start, seed=3))
    for others in runs[1:]:
        assert all(same(one, other) for one, other in zip(runs[0], others, strict=True))


def test_the_seed_decides(few: StereoPhotographs, start: RayCaster) -> None:
    first, again, other = (match_views(few, start, seed)[0] for seed in (1, 1, 2))
    assert same(first, again) and not same(first, other)


def same(one: DepthMap, other: DepthMap) -> bool:
    pairs = [(one.depth, other.depth), (one.normal, other.normal), (one.score, other.score)]
    return all(a.tobytes() == b.tobytes() for a, b in pairs)


def test_the_share_of_the_views_that_is_done(few: StereoPhotographs, start: RayCaster) -> None:
    reported: list[float] = []
    match_views(few, start, seed=0, progress=reported.append)
    assert reported == pytest.approx([0.2, 0.4, 0.6, 0.8, 1.0])


@pytest.mark.parametrize("count", [1, 2])
def test_a_view_with_less_than_two_neighbours_shows_nothing(
    count: int, few: StereoPhotographs, start: RayCaster
) -> None:
    alone = StereoPhotographs(few.images[:count], few.cameras[:count])
    maps = match_views(alone, start, seed=0)
    assert (maps[0].depth == 0).all() and (maps[0].score == -1).all()
    assert (weigh(alone, maps)[0] == 0).all()


def test_an_empty_mask_shows_nothing(few: StereoPhotographs, start: RayCaster) -> None:
    """Check that an empty mask shows nothing of its own view, and tells nothing of the others'."""
    empty = few.images[1] * np.array([1, 1, 1, 0], np.float32)
    maps = match_views(replace(few, images=[few.images[0], empty, *few.images[2:]]), start, seed=0)
    assert (maps[1].depth == 0).all() and (maps[1].score == -1).all()
    without = StereoPhotographs([few.images[0], *few.images[2:]], [few.cameras[0], *few.cameras[2:]])
    assert same(maps[0], match_views(without, start, seed=0)[0])
    assert (maps[0].depth > 0).any()


def test_noise_at_unknown_pixels_changes_nothing(start: RayCaster) -> None:
    """Check that maps tell of known pixels alone, and are to the byte the same whatever stands at others."""
    views = photographs(True, 0.0, cameras_above(6, 80))
    noisy = [[with_noise(view, seed) for view in views] for seed in (1, 2)]
    first, second = (match_views(stereo_photographs(some), start, seed=0) for some in noisy)
    assert all(same(one, other) for one, other in zip(first, second, strict=True))
    for view, found in zip(noisy[0], first, strict=True):
        assert view.valid_mask is not None and (found.depth > 0).sum() > 300
        assert (found.depth[~view.valid_mask] == 0).all()


@pytest.fixture(scope="module")
def perfect(few: StereoPhotographs) -> list[DepthMap]:
    mesh = pressed()
    caster, maps = RayCaster(mesh.vertices, mesh.faces), []
    for camera in few.cameras:
        hits = caster.cast(camera)
        maps.append(DepthMap(hits.depth, hits.normal, np.where(hits.mask, 0.9, -1).astype(np.float32)))
    return maps


def in_the_bowl(few: StereoPhotographs, maps: list[DepthMap]) -> np.ndarray:
    """Return the weights of the first map's pixels that show the bowl."""
    places = few.cameras[0].center + pixel_rays(few.cameras[0]) * maps[0].depth[..., None]
    in_bowl = np.linalg.norm(places - [0, 0, CAP], axis=-1) < 0.2
    chosen: np.ndarray = weigh(few, maps)[0][(maps[0].depth > 0) & in_bowl]
    return chosen


def farther(found: DepthMap, pixels: float, few: StereoPhotographs) -> DepthMap:
    return replace(found, depth=found.depth * np.float32(1 + pixels / few.cameras[0].K[0, 0]))


def test_perfect_maps_confirm_one_another(few: StereoPhotographs, perfect: list[DepthMap]) -> None:
    """Check that what correlates well weighs as much as it is seen head-on, and what doesn't, less."""
    rays = pixel_rays(few.cameras[0])
    cosines = -(rays * perfect[0].normal).sum(axis=-1) / np.linalg.norm(rays, axis=-1)
    weights = weigh(few, perfect)[0]
    inner = weights > 0
    assert inner.sum() > 0.6 * (perfect[0].depth > 0).sum()
    np.testing.assert_allclose(weights[inner], np.clip(cosines[inner], 0.1, 1), atol=1e-5)
    dull = [replace(perfect[0], score=perfect[0].score - 0.6), *perfect[1:]]
    assert (in_the_bowl(few, dull) < 0.3 * in_the_bowl(few, perfect)).all()


def test_what_other_views_deny_weighs_nothing(few: StereoPhotographs, perfect: list[DepthMap]) -> None:
    """Check that depths that lie elsewhere confirm nothing, nor do normals that look elsewhere."""
    for pixels, confirms in ((0.0, True), (1.5, True), (-1.5, True), (3.0, False), (-3.0, False)):
        moved = [perfect[0], *(farther(found, pixels, few) for found in perfect[1:])]
        assert ((in_the_bowl(few, moved) > 0) == confirms).mean() > 0.9
    turned = [perfect[0], *(replace(found, normal=found.normal[..., [1, 2, 0]]) for found in perfect[1:])]
    assert (in_the_bowl(few, turned) == 0).all()


def test_views_that_look_past_a_place_outvote_those_that_confirm_it(
    few: StereoPhotographs, perfect: list[DepthMap]
) -> None:
    """Check that two views that look past a place outvote two that confirm it.

    What views see nearer hides the place from them and says nothing.
    """
    past, before = ([*perfect[:3], *(farther(found, off, few) for found in perfect[3:])] for off in (6.0, -6.0))
    assert (in_the_bowl(few, past) == 0).mean() > 0.9
    assert (in_the_bowl(few, before) > 0).mean() > 0.9


Changed = dict[str, Any]


def views(few: StereoPhotographs, **changed: object) -> StereoViews:
    usual = StereoViews(images=few.images, cameras=few.packed_cameras, view=0, neighbours=[1, 2], range=(2.0, 4.0))
    return usual._replace(**changed)  # type: ignore[arg-type]


def planes(**changed: object) -> StereoPlanes:
    usual = StereoPlanes(depth=np.zeros((48, 48), np.float32), normal=np.zeros((48, 48, 3), np.float32))
    return usual._replace(**changed)  # type: ignore[arg-type]


def settings(**changed: object) -> StereoSettings:
    return stereo_settings(MatchSettings())._replace(**changed)  # type: ignore[arg-type]


def search(few: StereoPhotographs, group: str = "", name: str = "", wrong: object = None) -> None:
    """Search with arguments that are right in everything, but for one of a group."""
    changed: dict[str, Changed] = {group: {name: wrong}}
    score = changed.get("", {}).get("score", np.zeros((48, 48), np.float32))
    _stereo.search(
        views(few, **changed.get("views", {})),
        planes(**changed.get("start", {})),
        settings(**changed.get("settings", {})),
        0,
        planes(**changed.get("found", {})),
        score,
    )


def judge_alike(few: StereoPhotographs, group: str, name: str, wrong: object) -> None:
    """Judge with such arguments."""
    changed: dict[str, Changed] = {group: {name: wrong}}
    score = changed.get("", {}).get("score", np.zeros((48, 48), np.float32))
    _stereo.judge(
        views(few, **changed.get("views", {})),
        planes(**changed.get("start", {})),
        settings(**changed.get("settings", {})),
        score,
    )


@pytest.mark.parametrize(
    ("group", "name", "wrong", "message"),
    [
        ("views", "cameras", np.zeros((4, 16), np.float32), "cameras"),
        ("views", "view", 5, "view"),
        ("views", "neighbours", [1, 5], "neighbours"),
        ("views", "neighbours", [1, 0], "neighbours"),
        ("start", "depth", np.zeros((48, 47), np.float32), "size"),
        ("start", "normal", np.zeros((47, 48, 3), np.float32), "size"),
        ("found", "depth", np.zeros((47, 48), np.float32), "size"),
        ("found", "normal", np.zeros((48, 47, 3), np.float32), "size"),
        ("", "score", np.zeros((47, 48), np.float32), "size"),
        ("views", "range", (0.0, 4.0), "range"),
        ("views", "range", (4.0, 2.0), "range"),
        ("views", "range", (float("nan"), 2.0), "range"),
        ("settings", "radius", 5, "settings"),
        ("settings", "radius", -1, "settings"),
        ("settings", "best", 0, "settings"),
    ],
)
def test_what_cannot_be_searched_is_refused(
    few: StereoPhotographs, group: str, name: str, wrong: object, message: str
) -> None:
    search(few)
    with pytest.raises(ValueError, match=message):
        search(few, group, name, wrong)
    if group == "found":
        return
    with pytest.raises(ValueError, match=message):
        judge_alike(few, group, name, wrong)


@pytest.mark.parametrize(
    ("group", "name", "wrong", "message"),
    [
        ("views", "images", [np.zeros((48, 48, 3), np.float32)] * 5, r"views\.images: .* got float32 \[48, 48, 3\]"),
        ("views", "cameras", np.zeros((5, 12), np.float32), r"views\.cameras: .* got float32 \[5, 12\]"),
        ("views", "view", -1, r"views\.view: .* got -1"),
        ("start", "depth", None, r"start\.depth: .* got NoneType"),
        ("found", "depth", np.zeros((48, 48, 1), np.float32), r"found\.depth: .* got float32 \[48, 48, 1\]"),
        ("settings", "radius", 1.5, r"settings\.radius: .* got 1\.5"),
    ],
)
def test_what_has_another_form_is_refused(
    few: StereoPhotographs, group: str, name: str, wrong: object, message: str
) -> None:
    with pytest.raises(TypeError, match=message):
        search(few, group, name, wrong)


def test_coarser_maps_count_where_finer_ones_hold_nothing() -> None:
    fine = np.zeros((4, 6), np.float32)
    fine[:2, :2], fine[0, 2] = 0.1, 1.0
    (found,) = weigh_gaps([np.full((2, 3), 0.8, np.float32)], [fine])
    np.testing.assert_allclose(found, [[0, 0.6, 0.8], [0.8, 0.8, 0.8]], atol=1e-6)
