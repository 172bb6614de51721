"""Epipolar residuals and tracks, held against OpenCV and against points whose place is known."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from mgsr.config.expert import PairOptions
from mgsr.data.camera import Camera
from mgsr.inspection.features import Features, match
from mgsr.inspection.pairs import Pair, epipolar_residuals, fundamental_matrix
from mgsr.inspection.pose_check import PoseGroups, group_by_pose
from mgsr.inspection.tracks import find_tracks
from mgsr.inspection.verdicts import Judged, Verdict, judge
from tests.inspection.room import ring_camera

CAMERAS = [ring_camera(turn, 20 + turn / 3) for turn in (0, 25, 50, 90)]
POINTS = np.random.default_rng(0).uniform(-0.5, 0.5, (40, 3))


def test_points_lie_on_their_epipolar_lines() -> None:
    here, there = (CAMERAS[i].project(POINTS)[0] for i in (0, 1))
    assert epipolar_residuals(CAMERAS[0], CAMERAS[1], here, there).max() < 1e-9


def test_residuals_are_sampsons() -> None:
    rng = np.random.default_rng(1)
    here, there = (CAMERAS[i].project(POINTS)[0] + rng.normal(0, 3, (40, 2)) for i in (0, 2))
    F = fundamental_matrix(CAMERAS[0], CAMERAS[2])
    square = [
        cv2.sampsonDistance(np.append(x, 1.0)[:, None], np.append(y, 1.0)[:, None], F)
        for x, y in zip(here, there, strict=True)
    ]
    assert epipolar_residuals(CAMERAS[0], CAMERAS[2], here, there) == pytest.approx(np.sqrt(square), rel=1e-6)


def features(seed: int = 2) -> list[Features]:
    """Return features of the points in all cameras, in a different order in each, with a descriptor for each point."""
    rng = np.random.default_rng(seed)
    descriptors = np.abs(rng.normal(size=(40, 128))).astype(np.float32)
    descriptors /= np.linalg.norm(descriptors, axis=1, keepdims=True)
    orders = [rng.permutation(40) for _ in CAMERAS]
    return [
        Features(camera.project(POINTS)[0][order], descriptors[order], 1.0, np.zeros(40, np.float32))
        for camera, order in zip(CAMERAS, orders, strict=True)
    ]


def pair(one: int, other: int, matches: np.ndarray, residual: float) -> Pair:
    everything = np.ones(len(matches), bool)
    return Pair(one, other, matches, everything, np.full(len(matches), residual), ~everything, 0, 1.0)


def test_matches_name_the_same_points() -> None:
    one, other = features()[:2]
    matches = match(one, other)
    assert len(matches) == 40
    assert np.allclose(one.descriptors[matches[:, 0]], other.descriptors[matches[:, 1]])


def test_tracks_are_the_points() -> None:
    found = features()
    pairs = [pair(i, i + 1, match(found[i], found[i + 1]), 0.1) for i in range(3)]
    tracks = find_tracks(CAMERAS, found, pairs)
    assert len(tracks.points) == 40 and len(tracks.of_point) == 160
    distances = np.linalg.norm(tracks.points[:, None] - POINTS[None], axis=2)
    assert distances.min(axis=1).max() < 1e-6
    assert tracks.reprojection(CAMERAS).max() < 1e-6


def judged(edges: list[tuple[int, int, Verdict]]) -> Judged:
    some = np.zeros((PairOptions().min_matches, 2), np.int64)
    verdicts = tuple(verdict for *_, verdict in edges)
    return Judged(tuple(pair(one, other, some, 0.2) for one, other, _ in edges), verdicts, verdicts)


def test_groups_are_those_that_agree() -> None:
    yes, no = Verdict.AGREES, Verdict.CONTRADICTS
    groups = group_by_pose(6, judged([(0, 1, yes), (1, 2, yes), (3, 4, yes), (0, 3, no), (2, 4, no), (5, 1, no)]))
    assert groups.group.tolist()[:5] == [0, 0, 0, 1, 1]
    # One pair alone is not enough against the last photograph.
    assert groups.contradictory.tolist() == [False, False, False, True, True, False]


def compared(cameras: list[Camera], found: list[Features]) -> list[Pair]:
    """Return the pairs (0, 1), (0, 2) and (1, 2) of three photographs, with all their matches."""
    pairs = []
    for one, other in [(0, 1), (0, 2), (1, 2)]:
        matches = match(found[one], found[other])
        places = (found[one].pixels[matches[:, 0]], found[other].pixels[matches[:, 1]])
        residuals = epipolar_residuals(cameras[one], cameras[other], *places)
        pairs.append(Pair(one, other, matches, np.ones(40, bool), residuals, np.zeros(40, bool), 0, 1.0))
    return pairs


def test_a_wrong_camera_does_not_accuse_a_pair_of_right_ones() -> None:
    """Check it where the right ones share their points with no other photograph."""
    turn = np.eye(4)
    turn[:3, :3] = cv2.Rodrigues(np.array([0.3, 0.3, 0.5]))[0]
    third = replace(CAMERAS[2], cam_from_world=turn @ CAMERAS[2].cam_from_world)
    cameras, found = [*CAMERAS[:2], third], features()
    verdicts = judge(cameras, found[:3], compared(cameras, found)).verdicts
    assert verdicts == (Verdict.AGREES, Verdict.CONTRADICTS, Verdict.CONTRADICTS)


def test_a_camera_that_moved_along_its_epipolar_lines_is_told() -> None:
    """Check that three photographs tell what two can't: the third camera stands elsewhere on its line to the first."""
    first, second, third = CAMERAS[:3]
    beyond = third.cam_from_world.copy()
    beyond[:3, 3] += 0.3 * third.cam_from_world[:3, :3] @ (first.center - third.center)
    found = features()
    for cameras, verdict in (
        (CAMERAS[:3], Verdict.AGREES),
        ([first, second, replace(third, cam_from_world=beyond)], Verdict.CONTRADICTS),
    ):
        pairs = compared(cameras, found)
        assert pairs[1].residual < 1e-6
        assert judge(cameras, found[:3], pairs).verdicts[1] is verdict


def test_a_small_group_accuses_nobody() -> None:
    """Check it on a capture of few matches: four photographs agree, eight others are decided otherwise."""
    group = np.array([0, 0, 0, 0, 1, 1, 2, 2, 3, 3, 4, 5])
    contradictions = np.array([0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 2, 2])
    assert not PoseGroups(group, contradictions, np.ones(12, bool)).contradictory.any()
    most = np.array([0] * 8 + [1, 1, 2, 3])
    assert PoseGroups(most, contradictions, np.ones(12, bool)).contradictory.tolist() == [False] * 10 + [True] * 2
