"""The templated maths of image, harmonics and adam in float64: derivatives against finite differences."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import ArrayLike

from mgsr.native import _adam, _harmonics, _image
from mgsr.native.structs import Harmonics
from tests.oracles import harmonics as oracle


class DifferentiableHarmonics(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, coeffs: torch.Tensor, means: torch.Tensor, center: torch.Tensor, degree: int) -> torch.Tensor:
        rgb = torch.empty_like(means)
        splats = Harmonics(coeffs=coeffs.detach(), means=means.detach(), center=center, degree=degree)
        _harmonics.harmonics_double(splats, rgb, None, None, None)
        ctx.save_for_backward(coeffs, means)
        ctx.rest = center, degree
        return rgb

    @staticmethod
    def backward(ctx: Any, v_rgb: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, None, None]:
        coeffs, means = (t.detach() for t in ctx.saved_tensors)
        v_coeffs, v_means, rgb = torch.zeros_like(coeffs), torch.zeros_like(means), torch.empty_like(means)
        center, degree = ctx.rest
        splats = Harmonics(coeffs=coeffs, means=means, center=center, degree=degree)
        _harmonics.harmonics_double(splats, rgb, v_rgb.contiguous(), v_coeffs, v_means)
        return v_coeffs, v_means, None, None


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_harmonics(degree: int) -> None:
    generator = torch.Generator().manual_seed(degree)
    options: dict[str, Any] = {"generator": generator, "dtype": torch.float64}
    coeffs = torch.randn(4, (degree + 1) ** 2, 3, **options) * 0.3
    means, center = torch.randn(4, 3, **options), torch.tensor([0.1, 0.2, -3.0], dtype=torch.float64)
    rgb = DifferentiableHarmonics.apply(coeffs, means, center, degree)
    assert ((rgb > 1e-3) | (rgb == 0)).all(), "move the scene away from the cut at 0"
    # float literals: 1e-8
    torch.testing.assert_close(rgb, oracle.harmonics_to_rgb(coeffs, means, center, degree), rtol=0, atol=1e-6)
    inputs = coeffs.requires_grad_(), means.requires_grad_()
    assert torch.autograd.gradcheck(lambda c, m: DifferentiableHarmonics.apply(c, m, center, degree), inputs)


def central_differences(function: Callable[[np.ndarray], ArrayLike], x: np.ndarray, step: float = 1e-6) -> np.ndarray:
    """Return the derivatives [inputs, outputs] of a function by central differences."""
    rows = []
    for i in range(len(x)):
        at = np.eye(len(x))[i] * step
        rows.append((np.atleast_1d(function(x + at)) - np.atleast_1d(function(x - at))) / (2 * step))
    return np.stack(rows)


@pytest.mark.parametrize("seed", range(5))
def test_ssim(seed: int) -> None:
    a, b = np.random.default_rng(seed).random((2, 30))
    moments = np.array([a.mean(), b.mean(), (a * a + b * b).mean(), (a * b).mean()])
    value, value_of_vjp, v_moments = _image.ssim_double(moments)
    covariance = np.cov(a, b, bias=True)
    luminance = (2 * a.mean() * b.mean() + 1e-4) / (a.mean() ** 2 + b.mean() ** 2 + 1e-4)
    structure = (2 * covariance[0, 1] + 9e-4) / (covariance[0, 0] + covariance[1, 1] + 9e-4)
    assert value == pytest.approx(luminance * structure, rel=1e-6)
    assert value_of_vjp == pytest.approx(value, rel=1e-12)
    numeric = central_differences(lambda m: _image.ssim_double(m)[0], moments)[:, 0]
    np.testing.assert_allclose(v_moments, numeric, rtol=1e-6, atol=1e-8)


def test_tv() -> None:
    weight, pair, v_pair = _image.tv_double(0.3, 0.2)
    assert weight == pytest.approx(math.exp(-0.2), rel=1e-12)
    assert pair == pytest.approx(0.09 * weight, rel=1e-12)
    assert v_pair == pytest.approx(0.6 * weight, rel=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_depth_normal(seed: int) -> None:
    generator = np.random.default_rng(seed)
    depths, v_normal = 2 + 0.2 * generator.random(4), generator.normal(size=3)
    ray = np.array([300.0, 280.0, *generator.normal(size=2) * 0.4])
    normal, v_depths = _image.depth_normal_double(depths, ray, v_normal)

    def forward(d: np.ndarray) -> np.ndarray:
        return np.array(_image.depth_normal_double(d, ray, v_normal)[0])

    left, right, up, down = depths
    here = np.array([ray[2], ray[3], 1.0])
    along_x, along_y = np.array([1 / ray[0], 0, 0]), np.array([0, 1 / ray[1], 0])
    across = right * (here + along_x) - left * (here - along_x)
    upright = down * (here + along_y) - up * (here - along_y)
    cross = -np.cross(across, upright)
    np.testing.assert_allclose(normal, cross / np.linalg.norm(cross), atol=1e-12)
    np.testing.assert_allclose(v_depths, central_differences(forward, depths) @ v_normal, rtol=1e-6, atol=1e-6)


def test_adam() -> None:
    value, first, second = _adam.adam_double(1.0, 0.5, 0.2, 0.3, 0.01, (0.9, 0.999, 1e-15, 2.0))
    assert first == pytest.approx(0.9 * 0.2 + 0.1 * 0.5, rel=1e-6)
    assert second == pytest.approx(0.999 * 0.3 + 0.001 * 0.25, rel=1e-6)
    assert value == pytest.approx(1 - 0.01 * first / (math.sqrt(second) * 2), rel=1e-9)
