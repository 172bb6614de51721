"""The camera in the form that kernels read."""

from __future__ import annotations

import ctypes

from mgsr.native import structs
from mgsr.native.cuda.params import Float


class CameraStruct(ctypes.Structure):
    """The struct Camera<float> of math/camera.h."""

    _fields_ = (
        ("R", Float * 9),
        ("t", Float * 3),
        *((name, Float) for name in ("fx", "fy", "cx", "cy", "width", "height")),
    )


def camera_struct(camera: structs.PinholeCamera) -> CameraStruct:
    """Return a camera as a struct for the kernels' parameters."""
    (a, b, c, x), (d, e, f, y), (g, h, i, z), _ = camera.cam_from_world.tolist()
    (fx, _, cx), (_, fy, cy), _ = camera.K.tolist()
    return CameraStruct((a, b, c, d, e, f, g, h, i), (x, y, z), fx, fy, cx, cy, camera.width, camera.height)


def intrinsics(camera: structs.PinholeCamera) -> tuple[float, float, float, float]:
    """Return fx, fy, cx and cy in pixels."""
    (fx, _, cx), (_, fy, cy), _ = camera.K.tolist()
    return fx, fy, cx, cy
