"""Find the direction that points up in a capture, from the orientation of its cameras."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mgsr.config.expert import UpOptions
from mgsr.data.camera import Camera


def up_direction(cameras: Sequence[Camera], options: UpOptions = UpOptions()) -> np.ndarray:
    """Return the unit direction [3] that points up in the frame of the cameras' poses.

    The first estimate is the mean of the cameras' up vectors. If an axis is within `options.near_axis` degrees, or the
    cameras are level with respect to the nearest axis, the result is that axis. Otherwise it is the direction with
    respect to which the cameras are most nearly level, if they face enough different sides. The mean alone would be
    tilted if more cameras look down from one side than from the others.
    """
    rows = np.array([camera.cam_from_world[:2, :3] for camera in cameras])
    rights = rows[:, 0]
    mean: np.ndarray = -rows[:, 1].mean(axis=0)
    if np.linalg.norm(mean) < options.min_mean:
        return _side_up(rights, options.lying)
    mean = mean / np.linalg.norm(mean)
    axis = _nearest_axis(mean)
    if _near(mean, axis, options.near_axis) or np.sqrt(((rights @ axis) ** 2).mean()) < options.level:
        return axis
    spreads, directions = np.linalg.eigh(rights.T @ rights / len(rights))
    if spreads[0] > options.level**2 or spreads[1] < options.around:
        return mean
    level = directions[:, 0] * np.sign(directions[:, 0] @ mean)
    axis = _nearest_axis(level)
    return axis if _near(level, axis, options.near_axis) else level


def _side_up(rights: np.ndarray, lying: float) -> np.ndarray:
    """Return the up axis [3] of cameras without a common up vector, given their right vectors [C,3].

    If all cameras lie on their side, as beside a turntable, it is the axis to their right; else it is z.
    """
    mean = rights.mean(axis=0)
    return _nearest_axis(mean) if np.linalg.norm(mean) > lying else np.array((0.0, 0.0, 1.0))


def _nearest_axis(direction: np.ndarray) -> np.ndarray:
    """Return the signed axis [3] nearest to a direction [3]."""
    axis = int(np.abs(direction).argmax())
    return np.asarray(np.sign(direction[axis]) * np.eye(3)[axis])


def _near(direction: np.ndarray, axis: np.ndarray, degrees: float) -> bool:
    """Return whether a direction [3] is within `degrees` of an axis [3]; both are unit vectors."""
    return bool(direction @ axis > np.cos(np.radians(degrees)))
