"""The surfel's projection in float64: its values from their definition, its derivative from finite differences."""

from __future__ import annotations

import numpy as np
import pytest

from mgsr.native import _surfels
from tests.math.test_gaussian_math import case as gaussian_case

Splat = tuple[np.ndarray, np.ndarray, np.ndarray]  # mean, quat, scale

SIZES = (3, 4, 2)


def case(seed: int) -> tuple[Splat, np.ndarray]:
    mean, quat, scale, camera = gaussian_case(seed)
    return (mean, quat, scale[:2].copy()), camera


def project(splat: Splat, camera: np.ndarray) -> np.ndarray:
    return np.array(_surfels.project_double(*splat, camera))


def to_pixels(splat: Splat, camera: np.ndarray, u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return pixel coordinates and camera depths of the splat's points (u, v), from the definition."""
    mean, quat, scale = splat
    w, x, y, z = quat / np.linalg.norm(quat)
    tu = np.array([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)])
    tv = np.array([2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)])
    world = mean + np.multiply.outer(u, scale[0] * tu) + np.multiply.outer(v, scale[1] * tv)
    local = world @ camera[:9].reshape(3, 3).T + camera[9:12]
    return local[..., :2] / local[..., 2:] * camera[12:14] + camera[14:16], local[..., 2]


@pytest.mark.parametrize("seed", range(6))
def test_pixels_are_carried_back_to_the_splat(seed: int) -> None:
    splat, camera = case(seed)
    u, v = np.random.default_rng(seed).uniform(-2, 2, (2, 50))
    pixels, depth = to_pixels(splat, camera, u, v)
    s = project(splat, camera)
    d = pixels - s[:2]
    w = 1 + d @ s[7:9]
    np.testing.assert_allclose(d @ s[3:7].reshape(2, 2).T / w[:, None], np.stack([u, v], -1), atol=1e-9)
    np.testing.assert_allclose(s[2] / w, depth, atol=1e-9)


@pytest.mark.parametrize("seed", range(6))
def test_outline_is_the_image_of_the_circle(seed: int) -> None:
    splat, camera = case(seed)
    out = _surfels.outline_double(*splat, camera, 4.0, 0.01)
    angle = np.linspace(0, 2 * np.pi, 60)
    pixels, _ = to_pixels(splat, camera, 2 * np.cos(angle), 2 * np.sin(angle))
    d = pixels - project(splat, camera)[:2] - np.array(out[:2])
    inverse = np.linalg.inv([[out[2], out[3]], [out[3], out[4]]])
    np.testing.assert_allclose(np.einsum("ni,ij,nj->n", d, inverse, d), 1, atol=1e-7)


def test_outline_says_when_the_disk_reaches_the_camera() -> None:
    splat, camera = case(0)
    depth = project(splat, camera)[2]
    assert not _surfels.outline_double(*splat, camera, 4.0, depth - 1e-3)
    assert not _surfels.outline_double(splat[0], splat[1], 50 * splat[2], camera, 4.0, 0.01)


@pytest.mark.parametrize("seed", range(6))
def test_projection_vjp(seed: int) -> None:
    splat, camera = case(seed)
    v_out = np.random.default_rng(seed + 99).normal(size=12)
    grads = _surfels.project_double_vjp(*splat, camera, v_out)
    for which, size in enumerate(SIZES):
        for i in range(size):
            ends: list[float] = []
            for step in (1e-6, -1e-6):
                mean, quat, scale = splat
                moved = (mean.copy(), quat.copy(), scale.copy())
                moved[which][i] += step
                ends.append(float(v_out @ project(moved, camera)))
            numeric = (ends[0] - ends[1]) / 2e-6
            # Slanted splats bend within a step; 1e-6 of the gradient's own size is what central differences leave.
            assert abs(numeric - grads[which][i]) < 3e-6 * max(1.0, abs(numeric)), (which, i)
