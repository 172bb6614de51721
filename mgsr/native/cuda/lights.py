"""Reflected light and a flash's on rendered images, on a card."""

from __future__ import annotations

import ctypes

from torch import Tensor

from mgsr.native.cuda.launcher import Launcher
from mgsr.native.cuda.params import Float, Long, pointer, pointers

THREADS = 256


class ReflectionParams(ctypes.Structure):
    """These structs are those of kernels/lights/lights.cu."""

    _fields_ = (("pixels", Long), *pointers("transmitted", "weight", "own", "mirrored", "color", "reflected"))


class ReflectionVjpParams(ctypes.Structure):
    _fields_ = (("pixels", Long), *pointers("v_color", "reflected", "weight", "v_reflected", "v_weight"))


class LightUpParams(ctypes.Structure):
    _fields_ = (
        ("pixels", Long),
        *pointers("even", "alpha", "background", "lit"),
        ("offset", Float),
        *pointers("image"),
    )


class LightUpVjpParams(ctypes.Structure):
    _fields_ = (
        ("pixels", Long),
        *pointers("v_image", "background", "lit"),
        ("offset", Float),
        *pointers("v_even", "v_alpha"),
    )


class LightKernels:
    """Lights on one launcher."""

    def __init__(self, launcher: Launcher) -> None:
        self._launcher = launcher

    def add_reflection(
        self,
        transmitted: Tensor,
        weight: Tensor,
        own: Tensor | None,
        mirrored: Tensor | None,
        color: Tensor,
        reflected: Tensor,
    ) -> None:
        """Write color and reflected [H,W,3]."""
        arrays = (transmitted, weight, own, mirrored, color, reflected)
        self._run("lights_reflection", weight, ReflectionParams(weight.numel(), *map(pointer, arrays)))

    def add_reflection_vjp(
        self, v_color: Tensor, reflected: Tensor, weight: Tensor, v_reflected: Tensor, v_weight: Tensor
    ) -> None:
        """Write v_reflected [H,W,3] and v_weight [H,W]."""
        arrays = (v_color, reflected, weight, v_reflected, v_weight)
        self._run("lights_reflection_vjp", weight, ReflectionVjpParams(weight.numel(), *map(pointer, arrays)))

    def light_up(
        self, even: Tensor, alpha: Tensor, background: Tensor, lit: Tensor, offset: float, image: Tensor
    ) -> None:
        """Write the lit image [H,W,3]."""
        arrays = map(pointer, (even, alpha, background, lit))
        self._run("lights_light_up", lit, LightUpParams(lit.numel(), *arrays, offset, pointer(image)))

    def light_up_vjp(
        self, v_image: Tensor, background: Tensor, lit: Tensor, offset: float, v_even: Tensor, v_alpha: Tensor
    ) -> None:
        """Write v_even [H,W,3] and v_alpha [H,W]."""
        arrays = map(pointer, (v_image, background, lit))
        written = map(pointer, (v_even, v_alpha))
        self._run("lights_light_up_vjp", lit, LightUpVjpParams(lit.numel(), *arrays, offset, *written))

    def _run(self, kernel: str, plane: Tensor, params: ctypes.Structure) -> None:
        self._launcher.launch("lights", kernel, -(-plane.numel() // THREADS), THREADS, params)
