"""What an inspection finds in captures that are broken on purpose, and that it finds nothing in good ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mgsr.config.expert import CoverageOptions, InspectionConfig, PairOptions, PhotoCheckOptions
from mgsr.data.images import linear_to_srgb, srgb_to_linear, to_uint8
from mgsr.data.readers import load_scene
from mgsr.data.scene import Scene, View
from mgsr.inspection.findings import Code, Finding, Severity
from mgsr.inspection.inspect import inspect_scene
from mgsr.pipeline.scene_check import without_contradictory
from tests.inspection.room import DISTANCE, RING, Room, azimuth, moved, photograph, ring_camera, room_scene

CLUSTER = {3, 4, 5, RING + 3, RING + 4, RING + 5}


@pytest.fixture(scope="module")
def room() -> Room:
    return Room.drawn()


def found(scene: Scene) -> dict[Code, Finding]:
    return {finding.code: finding for finding in inspect_scene(scene).findings}


def names(indices: set[int]) -> tuple[str, ...]:
    return tuple(f"{index:03d}" for index in sorted(indices))


def changed(views: list[View], indices: set[int], change: Callable[[View], View]) -> list[View]:
    return [change(view) if index in indices else view for index, view in enumerate(views)]


def test_a_good_capture_has_no_faults_and_exact_cameras(room: Room) -> None:
    inspection = inspect_scene(room_scene(room.views))
    assert {finding.code for finding in inspection.findings} == {Code.UNSEEN_SIDE, Code.SMALL_IMAGES}
    assert inspection.worst is Severity.NOTE
    residuals = [photo.residual for photo in inspection.photographs]
    reprojections = [photo.reprojection for photo in inspection.photographs]
    # The patterns are sharp to half a pixel.
    assert all(value is not None and value < 0.5 for value in (*residuals, *reprojections))


def test_a_cluster_with_a_second_copy_of_the_structure(room: Room) -> None:
    scene = room_scene(changed(room.views, CLUSTER, lambda view: moved(view, 35, np.array([0.8, -0.5, 0.1]))))
    inspection = inspect_scene(scene)
    worst = inspection.findings[0]
    assert worst.code is Code.DOUBLED_STRUCTURE and worst.severity is Severity.ERROR
    assert set(worst.photographs) == set(names(CLUSTER)) and worst.amount > 10
    kept = without_contradictory(scene, inspection)
    assert {view.name for view in (*kept.train, *kept.test)} == set(names(set(range(2 * RING)) - CLUSTER))
    assert kept.notes == ("the poses of 6 of 28 photographs contradict what they show (003, 004, 005, ...): left out",)


def test_single_wrong_poses(room: Room) -> None:
    scene = room_scene(changed(room.views, {4, 20}, lambda view: moved(view, 8, np.zeros(3))))
    finding = found(scene)[Code.CONTRADICTORY_POSE]
    assert finding.photographs == names({4, 20}) and finding.severity is Severity.WARNING


def turned(view: View, axis: str, degrees: float) -> View:
    """Return the view with its camera turned about an axis of its own: x, y, or z, which is the line of sight."""
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_euler(axis, degrees, degrees=True).as_matrix()
    return replace(view, camera=replace(view.camera, cam_from_world=turn @ view.camera.cam_from_world))


@pytest.mark.parametrize(("axis", "degrees"), [("x", 2), pytest.param("z", 4, marks=pytest.mark.slow)])
def test_a_camera_turned_by_a_few_degrees(room: Room, axis: str, degrees: float) -> None:
    views = changed(room.views, {9}, lambda view: turned(view, axis, degrees))
    assert inspect_scene(room_scene(views)).contradictory == ("009",)


@pytest.mark.slow
def test_poses_of_other_photographs(room: Room) -> None:
    cameras = [view.camera for view in room.views]
    shuffled = [replace(view, camera=cameras[index * 5 % 28]) for index, view in enumerate(room.views)]
    finding = found(room_scene(shuffled))[Code.WRONG_POSES]
    assert finding.severity is Severity.ERROR and not finding.photographs


@pytest.mark.slow
def test_inaccurate_poses(room: Room) -> None:
    rng = np.random.default_rng(0)
    scene = room_scene([moved(view, rng.normal(0, 0.5), rng.normal(0, 0.03, 3)) for view in room.views])
    findings = found(scene)
    assert findings[Code.INACCURATE_POSES].severity is Severity.WARNING
    assert 1.5 < findings[Code.INACCURATE_POSES].amount < 10


def test_ten_blurred_frames(room: Room) -> None:
    blurred = set(range(1, 28, 3)) | {0}
    scene = room_scene(
        changed(room.views, blurred, lambda view: replace(view, image=cv2.GaussianBlur(view.image, (0, 0), 3)))
    )
    finding = found(scene)[Code.BLURRED]
    assert finding.photographs == names(blurred) and finding.amount > 1.4 and "flawed=drop" in finding.cure


def test_one_side_missing(room: Room) -> None:
    kept = [view for index, view in enumerate(room.views) if not 100 < azimuth(index) % 360 < 260]
    scene = room_scene(kept)
    findings = [finding for finding in inspect_scene(scene).findings if finding.code is Code.UNSEEN_SIDE]
    (gap,) = findings
    assert gap.severity is Severity.WARNING and gap.unit == "sr" and 0.5 < gap.amount < 4
    places = np.array(gap.places)
    assert np.allclose(np.linalg.norm(places, axis=1), DISTANCE, rtol=0.01)
    assert (np.abs(np.degrees(np.arctan2(places[:, 1], -places[:, 0]))) < 60).all()  # about 180 degrees


def test_exposure_jumps(room: Room) -> None:
    scene = room_scene(changed(room.views, {6}, lambda view: replace(view, image=view.image // 2)))
    finding = found(scene)[Code.EXPOSURE_JUMPS]
    assert "006" in finding.photographs and finding.severity is Severity.WARNING


def lit(view: View, factors: tuple[float, float]) -> View:
    """Return the view with the linear light of its left and of its right half multiplied."""
    light = srgb_to_linear(view.image / 255)
    middle = view.image.shape[1] // 2
    light[:, :middle] *= factors[0]
    light[:, middle:] *= factors[1]
    return replace(view, image=to_uint8(255 * linear_to_srgb(np.clip(light, 0, 1))))


@pytest.mark.slow
def test_exposures_are_told_from_light_that_changes_parts_of_the_photographs(room: Room) -> None:
    rng = np.random.default_rng(3)
    changes = 0.6 * np.exp(rng.normal(0, 0.2, (len(room.views), 2)))
    pairs = list(zip(room.views, changes, strict=True))
    exposed = found(room_scene([lit(view, (one, one)) for view, (one, _) in pairs]))[Code.EXPOSURE_JUMPS]
    assert exposed.severity is Severity.NOTE
    assert "by 1" in exposed.text or "by 2" in exposed.text, "drawn with a spread of a fifth"
    assert Code.EXPOSURE_JUMPS not in found(room_scene([lit(view, (one, other)) for view, (one, other) in pairs]))


def test_a_dark_photograph_of_a_plain_object() -> None:
    views = [View(f"{i:02d}", ring_camera(30.0 * i, 12), np.full((240, 320, 3), 200, np.uint8)) for i in range(12)]
    assert Code.EXPOSURE_JUMPS not in found(room_scene(views))
    views[3] = replace(views[3], image=views[3].image // 2)
    assert found(room_scene(views))[Code.EXPOSURE_JUMPS].photographs == ("03",)


@pytest.mark.slow
def test_a_turntable_before_a_wall_that_stands_still(room: Room) -> None:
    wall = photograph(ring_camera(10, 20))[0]

    mixed = [
        replace(view, image=np.where(mask[..., None] > 127, view.image, wall))
        for view, mask in zip(room.views, room.masks, strict=True)
    ]
    findings = found(room_scene(mixed))
    assert "turntable" in findings[Code.MOVING_BACKGROUND].text
    assert Code.WRONG_POSES not in findings and Code.CONTRADICTORY_POSE not in findings


def test_photographs_from_one_place() -> None:
    blank = np.full((240, 320, 3), 200, np.uint8)
    near = [View(f"{index:03d}", ring_camera(0.25 * index, 0), blank) for index in range(12)]
    finding = found(room_scene(near))[Code.LITTLE_PARALLAX]
    assert finding.severity is Severity.ERROR and finding.amount == pytest.approx(11 * 0.25, abs=0.01)


def masked(room: Room) -> list[View]:
    return [replace(view, alpha=mask.copy()) for view, mask in zip(room.views, room.masks, strict=True)]


def test_masks(room: Room) -> None:
    views = masked(room)
    assert found(room_scene(views)).keys() <= {Code.UNSEEN_SIDE, Code.SMALL_IMAGES}
    spoilt = views[5].alpha
    assert spoilt is not None
    spoilt[:, : spoilt.shape[1] // 2] = 0
    finding = found(room_scene(views))[Code.CONTRADICTORY_MASK]
    assert finding.photographs == ("005",) and 0.3 < finding.amount < 0.7


def test_a_small_object(room: Room) -> None:
    disc = (np.hypot(*(np.mgrid[:240, :320] - np.array([120, 160])[:, None, None])) < 20).astype(np.uint8) * 255
    scene = room_scene([replace(view, alpha=disc) for view in room.views])
    finding = found(scene)[Code.SMALL_OBJECT]
    assert finding.amount == pytest.approx(40, abs=1) and finding.unit == "px"


def test_a_long_object_is_not_small(room: Room) -> None:
    bar = np.zeros((240, 320), np.uint8)
    bar[110:122, 60:260] = 255
    assert Code.SMALL_OBJECT not in found(room_scene([replace(view, alpha=bar) for view in room.views]))


def test_few_photographs_keep_their_warning(room: Room) -> None:
    scene = replace(room_scene(room.views), warning="too few photographs: 4; take 20 or more that overlap")
    finding = found(scene)[Code.FEW_PHOTOGRAPHS]
    assert (finding.text, finding.cure) == ("too few photographs: 4", "take 20 or more that overlap")


def test_small_images_and_few_of_them() -> None:
    views = [View(f"{i}", ring_camera(90.0 * i, 12), np.full((240, 320, 3), 200, np.uint8)) for i in range(2)]
    scene = replace(room_scene([*views, *views, *views]), train=views, test=[])
    assert inspect_scene(scene).photographs[0].residual is None


GOOD = {
    "handheld/hand_spot": set(),
    "handheld/hand_teapot": set(),
    "nerf_synthetic/lego": set(),
    "real/beercan_colmap": {Code.BLURRED, Code.UNSEEN_SIDE},
    "real/dtu_scan65": {Code.UNSEEN_SIDE},
    "real/middlebury_dino48": {Code.UNSEEN_SIDE},
    "scenes/bob_chrome_hdr": set(),
    "scenes/bunny_flash": set(),
    "scenes/spot_soft": set(),
    "scenes/teapot_hdr": set(),
    "scenes/wingnut_dark": set(),
}


@pytest.mark.slow
@pytest.mark.parametrize("path", GOOD)
def test_good_captures_raise_no_false_alarm(shared_data: Path, path: str) -> None:
    findings = inspect_scene(load_scene(shared_data / path)).findings
    lines = [finding.line for finding in findings]
    assert {finding.code for finding in findings if finding.severity is not Severity.NOTE} == GOOD[path], lines
    assert (Code.EXPOSURE_JUMPS in {finding.code for finding in findings}) == path.startswith("handheld/"), lines


@pytest.mark.slow
def test_a_real_capture_with_a_doubled_cluster(shared_data: Path) -> None:
    scene = load_scene(shared_data / "handheld/hand_spot")
    cluster = {view.name for view in scene.train[10:20]}
    train = [moved(view, 50, np.array([0.2, 0.1, 0.0])) if view.name in cluster else view for view in scene.train]
    inspection = inspect_scene(replace(scene, train=train))
    assert inspection.findings[0].code is Code.DOUBLED_STRUCTURE
    assert set(inspection.contradictory) <= cluster and len(inspection.contradictory) > 6


@pytest.mark.slow
@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_a_real_camera_turned_by_two_degrees(shared_data: Path, axis: str) -> None:
    scene = load_scene(shared_data / "handheld/hand_spot")
    train = changed(scene.train, {18}, lambda view: turned(view, axis, 2))
    assert inspect_scene(replace(scene, train=train)).contradictory == (scene.train[18].name,)


def test_options_reach_the_checks(room: Room) -> None:
    scene = room_scene(room.views)
    photos, coverage = PhotoCheckOptions(wide=1.0), CoverageOptions(small_angle=180.0)
    strict = InspectionConfig(photos=photos, coverage=coverage)
    codes = {finding.code for finding in inspect_scene(scene, options=strict).findings}
    assert {Code.WIDE_LENS, Code.LITTLE_PARALLAX} <= codes
    few = inspect_scene(scene, options=InspectionConfig(photographs=5, pairs=PairOptions(min_matches=100_000)))
    assert len(few.photographs) == 5 and all(each.residual is None for each in few.photographs)
