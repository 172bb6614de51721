"""What a flash makes of an image, against linear light."""

from __future__ import annotations

import numpy as np
import torch

from mgsr.ops.lights import light_up


def to_srgb(light: np.ndarray) -> np.ndarray:
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 1e-9) ** (1 / 2.4) - 0.055)


def test_paint_times_light_in_linear_light() -> None:
    """Of an object that half covers its pixels, too: what lies behind is not lit."""
    generator = np.random.default_rng(0)
    paint, light = generator.uniform(0.05, 1, (6, 8, 3)), generator.uniform(0.1, 1, (6, 8))
    alpha, behind = generator.choice([0, 0.5, 1], (6, 8)), np.array([0.2, 0.5, 0.9])
    on = (1 - alpha[..., None]) * behind
    even = alpha[..., None] * to_srgb(paint) + on
    expected = alpha[..., None] * to_srgb(paint * light[..., None]) + on
    got = light_up(*(torch.from_numpy(each) for each in (even, alpha, behind, light ** (1 / 2.4))))
    # The curve's straight part near black, which the formula leaves out, is a thousandth off at most here.
    assert np.abs(got.numpy() - expected).max() < 2e-3
    bright = paint.min(axis=-1) * light > 0.0032
    assert np.abs(got.numpy() - expected)[bright].max() < 1e-6


def test_gradients_are_those_of_the_formula() -> None:
    generator = torch.Generator().manual_seed(0)
    even, alpha = (
        torch.rand(shape, generator=generator, dtype=torch.float64, requires_grad=True) for shape in ((3, 4, 3), (3, 4))
    )
    behind, lit = torch.rand(3, generator=generator).double(), torch.rand(3, 4, generator=generator).double()
    assert torch.autograd.gradcheck(lambda *own: light_up(*own, behind, lit), (even, alpha))


def test_full_light_changes_nothing() -> None:
    even, alpha = torch.rand(3, 4, 3), torch.rand(3, 4)
    assert torch.equal(light_up(even, alpha, torch.rand(3), torch.ones(3, 4)), even)
