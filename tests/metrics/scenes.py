"""Cameras of the measurement scenes, read without the project's own readers."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from mgsr.data.camera import Camera


def blender_cameras(scene: Path, split: str) -> list[Camera]:
    """Read the cameras of transforms_{split}.json."""
    listed = json.loads((scene / f"transforms_{split}.json").read_text())
    width, height = listed["w"], listed["h"]
    focal = 0.5 * width / np.tan(listed["camera_angle_x"] / 2)
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    # OpenGL's camera looks along -z with y up; OpenCV's along z with y down.
    poses = [np.array(frame["transform_matrix"]) @ np.diag([1.0, -1, -1, 1]) for frame in listed["frames"]]
    return [Camera(K, np.linalg.inv(pose), width, height) for pose in poses]
