"""Tests of the up direction, for cameras whose true up is known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mgsr.data.camera import Camera
from mgsr.data.up_direction import up_direction

# Where a geocentric frame has its up direction: 47 degrees north, 8.3 degrees east.
TURN = Rotation.from_euler("ZY", [8.3, 43.0], degrees=True)
UP = np.array([np.cos(np.radians(47)) * np.cos(np.radians(8.3)), np.cos(np.radians(47)) * np.sin(np.radians(8.3))])
UP = np.append(UP, np.sin(np.radians(47)))


def level(azimuth: float, elevation: float, roll: float = 0.0) -> np.ndarray:
    """Return the rotation of a camera in a z-up world that looks at its middle from there; all in degrees."""
    around, high = np.radians([azimuth, elevation])
    forward = -np.array([np.cos(around) * np.cos(high), np.sin(around) * np.cos(high), np.sin(high)])
    right = np.array([-np.sin(around), np.cos(around), 0.0])
    rotation = np.stack([right, np.cross(forward, right), forward])
    return np.asarray(Rotation.from_euler("z", roll, degrees=True).as_matrix() @ rotation)


def cameras(rotations: list[np.ndarray], turn: Rotation | None = None) -> list[Camera]:
    """Return cameras in the world that `turn` leads to."""
    world = np.eye(3) if turn is None else turn.as_matrix()
    poses = [np.eye(4) for _ in rotations]
    for pose, rotation in zip(poses, rotations, strict=True):
        pose[:3, :3] = rotation @ world.T
    return [Camera(np.eye(3), pose, 2, 2) for pose in poses]


def degrees_between(one: np.ndarray, other: np.ndarray) -> float:
    assert np.linalg.norm(one) == pytest.approx(1)
    return float(np.degrees(np.arccos(np.clip(one @ other, -1, 1))))


RING = [
    level(azimuth, 25, roll) for azimuth, roll in zip(range(0, 360, 24), np.resize([1, -2, 3, -1], 15), strict=True)
]
# Looked at from above, and mostly from one side: the mean of the upper sides leans by some 30 degrees.
ONE_SIDED = [level(azimuth, 40, roll) for azimuth, roll in zip(range(30, 151, 10), np.resize([1, -1], 13), strict=True)]
ALL_SAME = [level(azimuth, 40) for azimuth in (-4, -2, 0, 2, 4)]


@pytest.mark.parametrize("views", [RING, ONE_SIDED, ALL_SAME])
@pytest.mark.parametrize(
    ("turn", "axis"),
    [
        (None, (0, 0, 1)),
        (Rotation.from_euler("x", 90, degrees=True), (0, -1, 0)),
        (Rotation.from_euler("x", -90, degrees=True), (0, 1, 0)),
        (Rotation.from_euler("y", 90, degrees=True), (1, 0, 0)),
    ],
)
def test_axes_are_taken_as_they_are(views: list[np.ndarray], turn: Rotation | None, axis: tuple[int, int, int]) -> None:
    np.testing.assert_allclose(up_direction(cameras(views, turn)), axis, atol=1e-12)


@pytest.mark.parametrize("views", [RING, ONE_SIDED])
def test_other_frames_stand_upright_too(views: list[np.ndarray]) -> None:
    np.testing.assert_allclose(TURN.apply([0, 0, 1]), UP, atol=1e-12)
    assert degrees_between(up_direction(cameras(views, TURN)), UP) < 1.0


def test_a_frame_that_leans_a_little_is_taken_by_its_axis() -> None:
    lean = Rotation.from_euler("x", 15, degrees=True)
    np.testing.assert_array_equal(up_direction(cameras(RING, lean)), [0, 0, 1])


def test_cameras_that_are_not_level_have_their_mean() -> None:
    tilted = [
        level(azimuth, 0, roll) for azimuth, roll in zip(range(0, 360, 30), np.resize([40, -40], 12), strict=True)
    ]
    mean = -np.sum([camera.cam_from_world[1, :3] for camera in cameras(tilted, TURN)], axis=0)
    found = up_direction(cameras(tilted, TURN))
    np.testing.assert_allclose(found, mean / np.linalg.norm(mean))


def test_lying_cameras_around_a_turntable() -> None:
    """Check cameras whose upper sides point everywhere, and their right sides along the axis that they go round."""
    lying = [level(azimuth, 0, 90) for azimuth in range(0, 360, 30)]
    np.testing.assert_array_equal(np.abs(up_direction(cameras(lying))), [0, 0, 1])
    turned = cameras(lying, Rotation.from_euler("x", 90, degrees=True))
    np.testing.assert_array_equal(np.abs(up_direction(turned)), [0, 1, 0])


def test_cameras_that_look_down_and_are_turned_everywhere() -> None:
    down = [
        np.array([[np.cos(a), np.sin(a), 0], [np.sin(a), -np.cos(a), 0], [0, 0, -1]]) for a in np.arange(12) * np.pi / 6
    ]
    np.testing.assert_array_equal(up_direction(cameras(down)), [0, 0, 1])
