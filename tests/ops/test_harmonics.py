"""Spherical harmonics against SciPy's, in every variant."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch

from mgsr.errors import TensorError
from mgsr.native import _harmonics
from mgsr.ops.harmonics import harmonics_to_rgb
from tests.ops.variants import ISAS, variant
from tests.optional import present
from tests.oracles import harmonics as oracle

CENTER = torch.tensor([0.1, 0.2, -3.0])


def scene(n: int, stored: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Draw coefficients, means and a gradient of the colours; a quarter of the channels are cut at 0."""
    generator = torch.Generator().manual_seed(n)
    coeffs = torch.randn(n, stored, 3, generator=generator) * 0.4
    return coeffs, torch.randn(n, 3, generator=generator), torch.randn(n, 3, generator=generator)


def gradients(
    function: Callable[..., torch.Tensor],
    coeffs: torch.Tensor,
    means: torch.Tensor,
    center: torch.Tensor,
    degree: int,
    v_rgb: torch.Tensor,
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    coeffs, means = coeffs.clone().requires_grad_(), means.clone().requires_grad_()
    rgb = function(coeffs, means, center, degree)
    rgb.backward(v_rgb)
    return rgb.detach(), present(coeffs.grad), present(means.grad)


@pytest.mark.parametrize("isa", ISAS)
@pytest.mark.parametrize("n", [1, 7, 8, 9, 1000])
@pytest.mark.parametrize(("degree", "stored"), [(0, 1), (0, 16), (1, 4), (1, 9), (2, 9), (2, 16), (3, 16)])
def test_matches_scipy(isa: str, n: int, degree: int, stored: int) -> None:
    coeffs, means, v_rgb = scene(n, stored)
    with variant(_harmonics, isa):
        came = gradients(harmonics_to_rgb, coeffs, means, CENTER, degree, v_rgb)
    expected = gradients(
        oracle.harmonics_to_rgb, coeffs.double(), means.double(), CENTER.double(), degree, v_rgb.double()
    )
    for a, b in zip(came, expected, strict=True):
        if b is None:  # degree 0 doesn't look at the means
            assert not a.any()
        else:  # sums of up to 48 float32 products of size 1
            torch.testing.assert_close(a.double(), b, rtol=1e-5, atol=2e-6)


def test_bands_above_the_degree_get_zero_gradients() -> None:
    coeffs, means, v_rgb = scene(9, 16)
    _, v_coeffs, _ = gradients(harmonics_to_rgb, coeffs, means, CENTER, 1, v_rgb)
    assert not v_coeffs[:, 4:].any()


def test_same_bytes_for_any_thread_count() -> None:
    coeffs, means, v_rgb = scene(3001, 16)
    results = []
    for threads in (1, 2, 5):
        with variant(_harmonics, threads=threads):
            results.append(gradients(harmonics_to_rgb, coeffs, means, CENTER, 3, v_rgb))
    for other in results[1:]:
        assert all(torch.equal(a, b) for a, b in zip(results[0], other, strict=True))


def test_no_splats() -> None:
    assert harmonics_to_rgb(torch.zeros(0, 16, 3), torch.zeros(0, 3), CENTER, 3).shape == (0, 3)


def test_a_splat_at_the_camera_is_finite() -> None:
    coeffs, _, v_rgb = scene(1, 16)
    results = gradients(harmonics_to_rgb, coeffs, CENTER[None], CENTER, 3, v_rgb)
    assert all(torch.isfinite(x).all() for x in results)


def test_nan_stays_with_its_splat() -> None:
    coeffs, means, _ = scene(9, 16)
    coeffs[4, 2, 1] = torch.nan
    rgb = harmonics_to_rgb(coeffs, means, CENTER, 3)
    assert torch.isnan(rgb[4, 1])
    assert torch.isnan(rgb).sum() == 1


def test_gradient_to_the_means_is_left_out_when_unasked() -> None:
    coeffs, means, v_rgb = scene(9, 16)
    coeffs.requires_grad_()
    harmonics_to_rgb(coeffs, means, CENTER, 3).backward(v_rgb)
    assert means.grad is None


def test_bad_arguments_are_named() -> None:
    with pytest.raises(TensorError, match="degree"):
        harmonics_to_rgb(torch.zeros(2, 4, 3), torch.zeros(2, 3), CENTER, 2)
    with pytest.raises(TensorError, match="coeffs"):
        harmonics_to_rgb(torch.zeros(2, 5, 3), torch.zeros(2, 3), CENTER, 1)
    with pytest.raises(TensorError, match="means"):
        harmonics_to_rgb(torch.zeros(2, 4, 3), torch.zeros(3, 3), CENTER, 1)
