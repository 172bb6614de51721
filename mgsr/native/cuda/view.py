"""The camera as kernels read it."""

from __future__ import annotations

import ctypes

import numpy as np

from mgsr.native.cuda.params import Float


class Camera(ctypes.Structure):
    """Camera<float> of math/camera.h."""

    _fields_ = (
        ("R", Float * 9),
        ("t", Float * 3),
        *((name, Float) for name in ("fx", "fy", "cx", "cy", "width", "height")),
    )


def camera_struct(K: np.ndarray, cam_from_world: np.ndarray, width: int, height: int) -> Camera:
    """K [3,3] pixels and cam_from_world [4,4], float64, of an image of that size."""
    rotation = (Float * 9)(*cam_from_world[:3, :3].ravel())
    translation = (Float * 3)(*cam_from_world[:3, 3])
    return Camera(rotation, translation, K[0, 0], K[1, 1], K[0, 2], K[1, 2], width, height)
