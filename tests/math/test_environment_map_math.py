"""The maths of the environment map in float64: values by another way, derivatives by differences."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from mgsr.native import _environment_map
from tests.oracles import environment_map as oracle

TURN = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))[0].copy()


def places(normal: np.ndarray, ray: np.ndarray, v: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Return the places on both maps [4], and the gradient of the normal."""
    found = _environment_map.places_double(TURN.ravel(), ray, normal, np.zeros(4) if v is None else v)
    return np.array(found[0]), np.array(found[1])


def cases() -> list[tuple[np.ndarray, np.ndarray]]:
    generator = np.random.default_rng(0)
    return [(generator.normal(size=3) * 10.0 ** generator.uniform(-3, 3), generator.normal(size=2)) for _ in range(40)]


def test_places_are_where_householder_reflects_the_ray() -> None:
    seen: set[tuple[float, ...]] = set()
    for normal, ray in cases():
        unit = TURN @ normal / np.linalg.norm(normal)
        reflected = (np.eye(3) - 2 * np.outer(unit, unit)) @ [*ray, 1.0]
        world, held = TURN.T @ reflected, reflected * [1, 1, -1]
        expected = oracle.octahedral(torch.tensor(np.stack([world, held], axis=1))).numpy().ravel()
        np.testing.assert_allclose(places(normal, ray)[0], expected, atol=1e-12)
        seen.update(((which, *(direction < 0)) for which, direction in enumerate((world, held))))
    assert len(seen) == 16  # every face of both octahedra


def test_the_normals_gradient_is_that_of_differences() -> None:
    for normal, ray in cases():
        v = np.random.default_rng(1).normal(size=4)
        step = 1e-6 * np.linalg.norm(normal)
        numeric = [
            ((places(normal + step * axis, ray)[0] - places(normal - step * axis, ray)[0]) @ v) / (2 * step)
            for axis in np.eye(3)
        ]
        atol = 1e-6 / float(np.linalg.norm(normal))
        np.testing.assert_allclose(places(normal, ray, v)[1], numeric, rtol=1e-6, atol=atol)


@pytest.mark.parametrize("side", [1.0, 2.0, 7.0])
def test_texels_and_their_slopes(side: float) -> None:
    for place in (-1.0, -1 + 0.9 / side, -0.3, 0.0, 0.6, 1 - 0.9 / side, 1.0):
        texel, slope = _environment_map.texel_double(place, side)
        assert texel == pytest.approx(np.clip((place + 1) / 2 * side - 0.5, 0, side - 1))
        assert slope == (side / 2 if 0 < texel < side - 1 else 0)
    assert _environment_map.texel_double(np.nan, side) == (0.0, 0.0)


def test_bilinear_and_its_derivatives() -> None:
    corners, x, y = np.array([0.3, -1.2, 2.0, 0.7]), 0.31, 0.84
    value, v = _environment_map.bilinear_double(corners, x, y)
    weights = np.outer([1 - y, y], [1 - x, x]).ravel()
    assert value == pytest.approx(weights @ corners)
    np.testing.assert_allclose(v[:4], weights)
    for at, moved in ((4, (1e-6, 0)), (5, (0, 1e-6))):
        ahead, _ = _environment_map.bilinear_double(corners, x + moved[0], y + moved[1])
        behind, _ = _environment_map.bilinear_double(corners, x - moved[0], y - moved[1])
        assert v[at] == pytest.approx((ahead - behind) / 2e-6, rel=1e-6)
