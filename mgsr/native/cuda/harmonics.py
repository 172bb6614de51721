"""The CUDA half of the spherical harmonics: the same calls as `mgsr.native._harmonics`."""

from __future__ import annotations

import ctypes

from torch import Tensor

from mgsr.native.cuda.launcher import Launcher
from mgsr.native.cuda.params import Float, Int, Long, addresses, pointer, pointers

THREADS = 64


class Params(ctypes.Structure):
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

    def forward(self, coeffs: Tensor, means: Tensor, center: Tensor, degree: int, rgb: Tensor) -> None:
        """Write rgb [N,3]."""
        self._run("forward", degree, coeffs, means, center, (rgb, None, None, None))

    def backward(
        self,
        coeffs: Tensor,
        means: Tensor,
        center: Tensor,
        degree: int,
        rgb: Tensor,
        v_rgb: Tensor,
        v_coeffs: Tensor,
        v_means: Tensor | None,
    ) -> None:
        """Write v_coeffs [N,K,3] and, where it is given, add to v_means [N,3]."""
        self._run("backward", degree, coeffs, means, center, (rgb, v_rgb, v_coeffs, v_means))

    def _run(
        self,
        direction: str,
        degree: int,
        coeffs: Tensor,
        means: Tensor,
        center: Tensor,
        arrays: tuple[Tensor | None, ...],
    ) -> None:
        n, k = coeffs.shape[:2]
        inputs = (pointer(coeffs), pointer(means), (Float * 3)(*center.tolist()))
        params = Params(n, k, degree, *inputs, *addresses(*arrays))
        self._launcher.launch("harmonics", f"harmonics_{direction}_{degree}", -(-n // THREADS), THREADS, params)
