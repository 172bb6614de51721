"""Reflected light and flash light on rendered images, on a GPU."""

from __future__ import annotations

import ctypes

from torch import Tensor

from mgsr.native.cuda.launcher import Launcher
from mgsr.native.cuda.params import Float, Long, addresses, pointer, pointers
from mgsr.native.structs import UnlitGradients

THREADS = 256


class ReflectionParams(ctypes.Structure):
    """The struct ReflectionParams of kernels/lights/lights.cu, as are the structs below."""

    _fields_ = (("pixels", Long), *pointers("transmitted", "weight", "own", "environment_map", "color", "reflected"))


class ReflectionVjpParams(ctypes.Structure):
    _fields_ = (
        ("pixels", Long),
        *pointers("v_color", "reflected", "weight", "add_transmitted", "add_weight", "add_own"),
        *pointers("v_transmitted", "v_weight", "v_own", "v_environment"),
    )


class LightUpParams(ctypes.Structure):
    _fields_ = (
        ("pixels", Long),
        *pointers("unlit", "alpha", "background", "shading"),
        ("offset", Float),
        *pointers("image"),
    )


class LightUpVjpParams(ctypes.Structure):
    _fields_ = (
        ("pixels", Long),
        *pointers("v_image", "background", "shading"),
        ("offset", Float),
        *pointers("add_alpha", "v_unlit", "v_alpha"),
    )


class LightKernels:
    """The kernels of reflected light and flash light on one launcher."""

    def __init__(self, launcher: Launcher) -> None:
        self._launcher = launcher

    def add_reflection(
        self,
        transmitted: Tensor,
        weight: Tensor,
        own: Tensor | None,
        environment: Tensor | None,
        color: Tensor,
        reflected: Tensor,
    ) -> None:
        """Write color and reflected [H,W,3] (see `with_reflection`).

        transmitted, own, environment [H,W,3]; weight [H,W].
        """
        arrays = (transmitted, weight, own, environment, color, reflected)
        self._run("lights_reflection", weight, ReflectionParams(weight.numel(), *addresses(*arrays)))

    def add_reflection_vjp(
        self,
        v_color: Tensor,
        reflected: Tensor,
        weight: Tensor,
        before: tuple[Tensor | None, ...],
        out: tuple[Tensor, ...],
    ) -> None:
        """Write the gradients of transmitted, own and environment [H,W,3] and of weight [H,W] to `out`.

        v_color, reflected [H,W,3]; weight [H,W]. before: gradients that are added to those of transmitted, weight and
        own.
        """
        arrays = addresses(v_color, reflected, weight, *before, *out)
        self._run("lights_reflection_vjp", weight, ReflectionVjpParams(weight.numel(), *arrays))

    def light_up(
        self, unlit: Tensor, alpha: Tensor, background: Tensor, shading: Tensor, offset: float, image: Tensor
    ) -> None:
        """Write the shaded image [H,W,3] of unlit [H,W,3], alpha [H,W], background [3] and shading [H,W]."""
        arrays = addresses(unlit, alpha, background, shading)
        self._run("lights_light_up", shading, LightUpParams(shading.numel(), *arrays, offset, pointer(image)))

    def light_up_vjp(
        self,
        v_image: Tensor,
        background: Tensor,
        shading: Tensor,
        offset: float,
        add_alpha: Tensor | None,
        out: UnlitGradients,
    ) -> None:
        """Write the gradients of the unlit image and of alpha to `out`.

        v_image [H,W,3]: the gradient of the shaded image. background [3]; shading [H,W]. add_alpha [H,W]: is added to
        the gradient of alpha.
        """
        arrays = addresses(v_image, background, shading)
        written = addresses(add_alpha, out.v_unlit, out.v_alpha)
        self._run("lights_light_up_vjp", shading, LightUpVjpParams(shading.numel(), *arrays, offset, *written))

    def _run(self, kernel: str, plane: Tensor, params: ctypes.Structure) -> None:
        self._launcher.launch("lights", kernel, -(-plane.numel() // THREADS), THREADS, params)
