"""The camera as kernels read it."""

from __future__ import annotations

import ctypes

import numpy as np

from mgsr.native.cuda.params import Float


class Camera(ctypes.Structure):
    """The struct Camera<float> of math/camera.h."""

    _fields_ = (
        ("R", Float * 9),
        ("t", Float * 3),
        *((name, Float) for name in ("fx", "fy", "cx", "cy", "width", "height")),
    )


def camera_struct(K: np.ndarray, cam_from_world: np.ndarray, width: int, height: int) -> Camera:
    """Return the struct of a camera with K [3,3] pixels and cam_from_world [4,4], both float64.

    width, height: of its image.
    """
    (a, b, c, x), (d, e, f, y), (g, h, i, z), _ = cam_from_world.tolist()
    (fx, _, cx), (_, fy, cy), _ = K.tolist()
    return Camera((a, b, c, d, e, f, g, h, i), (x, y, z), fx, fy, cx, cy, width, height)
