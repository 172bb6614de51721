"""The CUDA half of the spherical harmonics: the same calls as `mgsr.native._harmonics`."""

from __future__ import annotations

import ctypes

from torch import Tensor

from mgsr.native.cuda.launcher import Launcher
from mgsr.native.cuda.params import Float, Int, Long, addresses, pointer, pointers
from mgsr.native.structs import Harmonics

THREADS = 64


class HarmonicsParams(ctypes.Structure):
    """The struct HarmonicsParams of kernels/harmonics/harmonics.cu."""

    _fields_ = (
        ("n", Long),
        ("k", Int),
        ("degree", Int),
        *pointers("coeffs", "means"),
        ("center", Float * 3),
        *pointers("rgb", "v_rgb", "v_coeffs", "v_means"),
    )


class HarmonicsKernels:
    """The kernels of colours and their gradients on one launcher."""

    def __init__(self, launcher: Launcher) -> None:
        self._launcher = launcher

    def forward(self, splats: Harmonics, rgb: Tensor) -> None:
        """Write rgb [N,3]."""
        self._run("forward", splats, (rgb, None, None, None))

    def backward(self, splats: Harmonics, rgb: Tensor, v_rgb: Tensor, v_coeffs: Tensor, v_means: Tensor | None) -> None:
        """Write v_coeffs [N,K,3] and, if it is given, add to v_means [N,3]; rgb, v_rgb [N,3]: colours and gradient."""
        self._run("backward", splats, (rgb, v_rgb, v_coeffs, v_means))

    def _run(self, direction: str, splats: Harmonics, arrays: tuple[Tensor | None, ...]) -> None:
        n, k = splats.coeffs.shape[:2]
        inputs = (pointer(splats.coeffs), pointer(splats.means), (Float * 3)(*splats.center.tolist()))
        params = HarmonicsParams(n, k, splats.degree, *inputs, *addresses(*arrays))
        kernel = f"harmonics_{direction}_{splats.degree}"
        self._launcher.launch("harmonics", kernel, -(-n // THREADS), THREADS, params)
