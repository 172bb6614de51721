"""Both rasterizers behind one call, on any machine and by brute force in float64, with every gradient."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from mgsr.data.camera import Camera
from mgsr.ops.gaussians import GaussianOptions, Reflected, rasterize_gaussians
from mgsr.ops.surfels import SurfelOptions, rasterize_surfels
from tests.cuda.machines import Machine
from tests.ops.splat_scenes import random_splats, splat_arguments
from tests.oracles import gaussians as gaussian_oracle
from tests.oracles import surfels as surfel_oracle

Splats = dict[str, Tensor]
BACKGROUND = torch.tensor([0.2, 0.5, 0.9], dtype=torch.float64)
PLAIN = ("means", "quats", "scales", "opacities", "colors")
REFLECTED = ("refl_opacities", "refl_colors", "weights")
IMAGES = ("color", "alpha", "depth", "median_depth", "normal", "distortion", "reflected", "weight")
# Of the largest value: float32 rounding through a sum of some tens of layers.
TOLERANCE = {"images": 2e-5, "gradients": 3e-4}
# Where a weight changes by its own size over a small part of a pixel, more digits go.
STEEP = {"images": 1e-4, "gradients": 5e-3}

on_both_branches = pytest.mark.parametrize("branch", ["surfels", "gaussians"])


@dataclass(frozen=True)
class Setting:
    """The settings of a rendering beside splats and camera; lengths in the scene's unit."""

    near: float = 0.01
    far: float = 10.0
    compensate: bool = False
    images: tuple[str, ...] = IMAGES  # those that send a gradient


@dataclass(frozen=True)
class Result:
    """Images and gradients by name, float64 on the CPU; radii [N] where a kernel ran."""

    images: Splats
    gradients: Splats
    radii: Tensor | None = None

    def assert_finite(self) -> None:
        for name, tensor in (self.images | self.gradients).items():
            assert torch.isfinite(tensor).all(), f"{name}: {int((~torch.isfinite(tensor)).sum())} numbers not finite"


def facing_camera(width: int = 40, height: int = 28, focal: float = 45.0) -> Camera:
    """Return a camera at the origin that looks along z: a splat's depth is its z, to the bit."""
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]])
    return Camera(K, np.eye(4), width, height)


def scene(branch: str, count: int, seed: int = 0, size: float = 0.12) -> Splats:
    """Draw random splats around the origin, with a reflected half for the 3D branch, in numbers that float32 holds."""
    splats = random_splats(count, 2 if branch == "surfels" else 3, seed, size)
    if branch == "gaussians":
        extra = random_splats(count, 3, seed + 1000)
        splats["refl_opacities"], splats["refl_colors"] = extra["opacities"], extra["colors"]
        splats["weights"] = extra["colors"][:, 0]
    return held(splats)


def held(splats: Splats) -> Splats:
    """Return float64 splats whose values float32 holds, so that the oracle sees what a kernel sees."""
    return {name: tensor.float().double() for name, tensor in splats.items()}


def before_camera(branch: str, count: int, seed: int = 0, size: float = 0.12) -> Splats:
    """Draw splats as `scene` does, two units before `facing_camera`."""
    splats = scene(branch, count, seed, size)
    splats["means"][:, 2] += 2
    return held(splats)


def without(splats: Splats, index: int) -> Splats:
    """Return all splats but one."""
    return {name: torch.cat([tensor[:index], tensor[index + 1 :]]) for name, tensor in splats.items()}


def render(machine: Machine, branch: str, splats: Splats, view: Camera, setting: Setting | None = None) -> Result:
    """Render by the kernels of a machine, in float32."""
    setting = setting or Setting()
    rasterize = _surfels if branch == "surfels" else _gaussians
    rasters: list[Any] = []

    def on_machine(leaves: Splats, background: Tensor) -> Splats:
        there = {name: tensor.to(machine.device) for name, tensor in leaves.items()}
        rasters.append(rasterize(there, view, background.to(machine.device), setting))
        images = {name: getattr(rasters[0], name, None) for name in IMAGES}
        return {name: image.cpu() for name, image in images.items() if image is not None}

    with machine.running():
        result = differentiate(on_machine, splats, torch.float32, setting)
    return Result(result.images, result.gradients, rasters[0].stats.radii.cpu())


def brute_force(branch: str, splats: Splats, view: Camera, setting: Setting | None = None) -> Result:
    """Render by the oracle, in float64."""
    setting = setting or Setting()
    oracle = _surfel_oracle if branch == "surfels" else _gaussian_oracle

    def by_oracle(leaves: Splats, background: Tensor) -> Splats:
        out = oracle(leaves, view, background, setting)
        images = {name: getattr(out, name, None) for name in IMAGES}
        return {name: image for name, image in images.items() if image is not None}

    return differentiate(by_oracle, splats, torch.float64, setting)


def differentiate(
    rendering: Callable[[Splats, Tensor], Splats], splats: Splats, dtype: torch.dtype, setting: Setting
) -> Result:
    """Render, and differentiate a fixed random combination of the images."""
    leaves = {name: tensor.to(dtype).clone().requires_grad_() for name, tensor in splats.items()}
    images = rendering(leaves, BACKGROUND.to(dtype))
    generator, loss = torch.Generator().manual_seed(5), torch.zeros((), dtype=dtype)
    for name, image in images.items():
        weights = torch.randn(image.shape, generator=generator, dtype=torch.float64).to(dtype)
        if name in setting.images:
            loss = loss + (image * weights).sum()
    if loss.requires_grad:
        loss.backward()
    gradients = {name: torch.zeros_like(leaf) if leaf.grad is None else leaf.grad for name, leaf in leaves.items()}
    return Result(_doubles(images), _doubles(gradients))


def compare(
    machine: Machine,
    branch: str,
    splats: Splats,
    view: Camera,
    tolerance: dict[str, float] = TOLERANCE,
    setting: Setting | None = None,
) -> Result:
    """Compare a machine's images and gradients with the oracle's, and return the machine's."""
    got, expected = render(machine, branch, splats, view, setting), brute_force(branch, splats, view, setting)
    got.assert_finite()
    assert_close(got.images, expected.images, tolerance["images"])
    assert_close(got.gradients, expected.gradients, tolerance["gradients"])
    return got


def assert_close(ours: Splats, theirs: Splats, tolerance: float) -> None:
    """Check the largest error against the largest value of each tensor, or against 1 where all are smaller."""
    for name, expected in theirs.items():
        if expected.numel():
            error = (ours[name] - expected).abs().max() / expected.abs().max().clamp(min=1.0)
            assert error < tolerance, f"{name}: largest error {error:.2e} of its largest value"


def _doubles(tensors: Splats) -> Splats:
    return {name: tensor.detach().double() for name, tensor in tensors.items()}


def _plain(splats: Splats) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    return splat_arguments(splats[name] for name in PLAIN)


def _surfels(splats: Splats, view: Camera, background: Tensor, setting: Setting) -> Any:
    options = SurfelOptions(near=setting.near, far=setting.far, distortion=True)
    return rasterize_surfels(*_plain(splats), view, background, options)


def _gaussians(splats: Splats, view: Camera, background: Tensor, setting: Setting) -> Any:
    options = GaussianOptions(near=setting.near, compensate=setting.compensate)
    reflected = Reflected(*(splats[name] for name in REFLECTED))
    return rasterize_gaussians(*_plain(splats), view, background, reflected, options)


def _surfel_oracle(splats: Splats, view: Camera, background: Tensor, setting: Setting) -> Any:
    K, pose = torch.tensor(view.K), torch.tensor(view.cam_from_world)
    size = (view.width, view.height)
    return surfel_oracle.render(*_plain(splats), K, pose, *size, background, near=setting.near, far=setting.far)


def _gaussian_oracle(splats: Splats, view: Camera, background: Tensor, setting: Setting) -> Any:
    reflected = tuple(splats[name] for name in REFLECTED)
    return gaussian_oracle.render(
        *_plain(splats), view, background, reflected, near=setting.near, compensate=setting.compensate
    )
