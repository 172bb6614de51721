"""Spherical harmonics' CUDA kernels against SciPy's."""

from __future__ import annotations

import pytest
import torch

from mgsr.ops.harmonics import harmonics_to_rgb
from tests.cuda.machines import Machine, on_each_machine, on_each_machine_and_order
from tests.ops.test_harmonics import CENTER, gradients, scene
from tests.oracles import harmonics as oracle


def on(
    machine: Machine, coeffs: torch.Tensor, means: torch.Tensor, degree: int, v_rgb: torch.Tensor
) -> list[torch.Tensor]:
    coeffs, means, center = (t.to(machine.device) for t in (coeffs, means, CENTER))
    with machine.running():
        results = gradients(harmonics_to_rgb, coeffs, means, center, degree, v_rgb.to(machine.device))
    return [t.cpu() for t in results]


@on_each_machine_and_order
@pytest.mark.parametrize("n", [1, 64, 200])
@pytest.mark.parametrize(("degree", "stored"), [(0, 1), (0, 16), (1, 4), (1, 9), (2, 9), (2, 16), (3, 16)])
def test_matches_scipy(machine: Machine, n: int, degree: int, stored: int) -> None:
    coeffs, means, v_rgb = scene(n, stored)
    came = on(machine, coeffs, means, degree, v_rgb)
    doubles = (coeffs.double(), means.double(), CENTER.double(), degree, v_rgb.double())
    for a, b in zip(came, gradients(oracle.harmonics_to_rgb, *doubles), strict=True):
        if b is None:  # degree 0 doesn't look at the means
            assert not a.any()
        else:  # sums of up to 48 float32 products of size 1
            torch.testing.assert_close(a.double(), b, rtol=1e-5, atol=2e-6)


@on_each_machine
def test_nan_stays_with_its_splat(machine: Machine) -> None:
    coeffs, means, v_rgb = scene(9, 16)
    coeffs[4, 2, 1] = torch.nan
    rgb = on(machine, coeffs, means, 3, v_rgb)[0]
    assert torch.isnan(rgb[4, 1])
    assert torch.isnan(rgb).sum() == 1


@on_each_machine
def test_no_splats(machine: Machine) -> None:
    coeffs, means = torch.zeros(0, 16, 3, device=machine.device), torch.zeros(0, 3, device=machine.device)
    with machine.running():
        assert harmonics_to_rgb(coeffs, means, CENTER.to(machine.device), 3).shape == (0, 3)
