"""The projection's derivative against finite differences of itself, in float64."""

from __future__ import annotations

import numpy as np
import pytest

from mgsr.native import _gaussians


def case(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    pose, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    pose *= np.sign(np.linalg.det(pose))
    camera = np.concatenate([pose.ravel(), [0.1, -0.2, 3.0], [60.0, 50.0, 22.0, 17.0, 40.0, 30.0]])
    return rng.uniform(-0.5, 0.5, 3), rng.normal(size=4), rng.uniform(0.05, 0.4, 3), camera


def project(mean: np.ndarray, quat: np.ndarray, scale: np.ndarray, camera: np.ndarray) -> np.ndarray:
    return np.array(_gaussians.project_double(mean, quat, scale, camera, 0.3))


@pytest.mark.parametrize("seed", range(6))
def test_projection_vjp(seed: int) -> None:
    mean, quat, scale, camera = case(seed)
    v_out = np.random.default_rng(seed + 99).normal(size=7)
    grads = _gaussians.project_double_vjp(mean, quat, scale, camera, 0.3, v_out)
    for which, (value, grad) in enumerate(zip((mean, quat, scale), grads, strict=True)):
        for i in range(len(value)):
            ends: list[float] = []
            for step in (1e-6, -1e-6):
                inputs = (mean.copy(), quat.copy(), scale.copy())
                inputs[which][i] += step
                ends.append(float(v_out @ project(*inputs, camera)))
            numeric = (ends[0] - ends[1]) / 2e-6
            assert abs(numeric - grad[i]) < 1e-6 * max(1.0, abs(numeric)), (which, i)
