"""Spherical harmonics from SciPy's complex ones, in float64: independent of any table of constants."""

from __future__ import annotations

import numpy as np
import torch
from scipy.special import assoc_legendre_p, factorial


def basis(directions: torch.Tensor, degree: int) -> torch.Tensor:
    """Return real harmonics [N, (degree+1)^2] of unit directions [N, 3].

    They are in the order m = -l..l, with Condon-Shortley phase.
    """
    powers = [_polynomial(level, m) for level in range(degree + 1) for m in range(-level, level + 1)]
    x, y, z = directions.unbind(1)
    columns = []
    for terms in powers:
        columns.append(sum(factor * x**i * y**j * z**k for (i, j, k), factor in terms.items()))
    return torch.stack([c if isinstance(c, torch.Tensor) else torch.full_like(x, c) for c in columns], 1)


def _polynomial(level: int, m: int) -> dict[tuple[int, int, int], float]:
    """Return the harmonic as a homogeneous polynomial, fitted to the definition at points of the sphere."""
    exponents = [(i, j, level - i - j) for i in range(level + 1) for j in range(level + 1 - i)]
    points = np.random.default_rng(level).normal(size=(60, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    matrix = np.stack([np.prod(points**e, axis=1) for e in exponents], 1)
    factors, *_ = np.linalg.lstsq(matrix, _definition(points, level, m), rcond=None)
    return {e: float(f) for e, f in zip(exponents, factors, strict=True) if abs(f) > 1e-12}


def _definition(points: np.ndarray, level: int, m: int) -> np.ndarray:
    azimuth = np.arctan2(points[:, 1], points[:, 0])
    order = abs(m)
    scale = np.sqrt((2 * level + 1) / (4 * np.pi) * factorial(level - order) / factorial(level + order))
    legendre = assoc_legendre_p(level, order, points[:, 2])[0]
    if m == 0:
        values: np.ndarray = scale * legendre
    else:
        values = np.sqrt(2) * scale * legendre * (np.cos(order * azimuth) if m > 0 else np.sin(order * azimuth))
    return values


def harmonics_to_rgb(coeffs: torch.Tensor, means: torch.Tensor, center: torch.Tensor, degree: int) -> torch.Tensor:
    directions = torch.nn.functional.normalize(means - center, dim=1)
    used = (degree + 1) ** 2
    return (torch.einsum("nk,nkc->nc", basis(directions, degree), coeffs[:, :used]) + 0.5).clamp_min(0)
