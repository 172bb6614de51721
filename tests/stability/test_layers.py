"""Many layers, opaque and faint, cut-offs, ties and nothing at all, on every kernel."""

from __future__ import annotations

import pytest
import torch

from tests.cuda.machines import Machine, on_every_kernel
from tests.stability.branches import (
    BACKGROUND,
    STEEP,
    Splats,
    before_camera,
    brute_force,
    compare,
    facing_camera,
    held,
    on_both_branches,
    render,
)


def layers(branch: str, count: int, opacity: float, size: float = 50.0) -> Splats:
    """Build flat splats across the whole image, one behind the other from depth 2 to 4, in colours of their own."""
    splats = before_camera(branch, count)
    splats["means"] = torch.zeros(count, 3, dtype=torch.float64)
    splats["means"][:, 2] = torch.linspace(2, 4, count)
    splats["quats"] = torch.tensor([1.0, 0, 0, 0], dtype=torch.float64).repeat(count, 1)
    splats["scales"][:] = size
    splats["opacities"][:] = opacity
    if branch == "gaussians":
        splats["refl_opacities"][:] = opacity
        splats["scales"][:, 2] = 1e-3
    return held(splats)


@on_every_kernel
@on_both_branches
@pytest.mark.parametrize("opacity", [1.0, 0.9991, 0.998, 0.9, 0.5])
def test_fifty_opaque_layers(machine: Machine, branch: str, opacity: float) -> None:
    """Check opaque layers: behind an alpha near 1 what is left is divided by almost nothing to get its gradient."""
    compare(machine, branch, layers(branch, 50, opacity), facing_camera(16, 16))


@on_every_kernel
@on_both_branches
@pytest.mark.parametrize("count", [10_000])
def test_ten_thousand_faint_layers(machine: Machine, branch: str, count: int) -> None:
    """Check layers of alpha 1/255 each, or a hair more, so that rounding does not decide.

    The pixel stops after 2,339 of them.
    """
    got = compare(machine, branch, layers(branch, count, 1.001 / 255), facing_camera(2, 2))
    stops = int((got.gradients["colors"].abs().sum(1) > 0).sum())
    assert 2335 < stops < 2345


@on_every_kernel
@on_both_branches
def test_the_faintest_splat_counts_at_its_centre(machine: Machine, branch: str) -> None:
    """Check that an opacity of 1/255 reaches the threshold in one point, a pixel's centre here."""
    splats = layers(branch, 1, 1 / 255, size=0.1)
    alpha = render(machine, branch, splats, facing_camera(3, 3)).images["alpha"]
    assert alpha[1, 1] == pytest.approx(1 / 255, rel=1e-6)
    assert int((alpha > 0).sum()) == 1


@on_every_kernel
@on_both_branches
@pytest.mark.parametrize("above", [True, False], ids=["above", "below"])
def test_transmittance_at_the_cut_off(machine: Machine, branch: str, above: bool) -> None:
    """Check four layers that leave a hundred-thousandth more, or less, than the 1e-4 at which a pixel stops."""
    left = 1e-4 * (1 + (1e-5 if above else -1e-5))
    got = compare(machine, branch, layers(branch, 4, 1 - left**0.25, size=1e4), facing_camera(16, 16))
    expected = left if above else left**0.75
    assert torch.allclose(1 - got.images["alpha"], torch.tensor(expected, dtype=torch.float64), rtol=2e-3)


@on_every_kernel
@on_both_branches
def test_equal_depths_blend_by_index(machine: Machine, branch: str) -> None:
    """Check that two thousand splats in one plane, more than a chunk of the sort, blend by index.

    The oracle's sort is stable.
    """
    splats = before_camera(branch, 2000, size=0.1)
    splats["means"][:, 2] = 2.0
    splats["opacities"] *= 0.1
    compare(machine, branch, held(splats), facing_camera(8, 8))


@on_every_kernel
@on_both_branches
@pytest.mark.parametrize("what", ["empty", "behind", "beside", "faint"])
def test_nothing_to_see(machine: Machine, branch: str, what: str) -> None:
    """Check that nothing to see gives the background alone, to the bit, and no gradient."""
    splats = before_camera(branch, 5)
    if what == "empty":
        splats = {name: tensor[:0] for name, tensor in splats.items()}
    elif what == "behind":
        splats["means"][:, 2] *= -1
    elif what == "beside":
        splats["means"][:, 0] += 100
    else:
        splats["opacities"][:] = 0.9 / 255
        if branch == "gaussians":
            splats["refl_opacities"][:] = 0.9 / 255
    got = render(machine, branch, splats, facing_camera())
    assert torch.equal(got.images["color"], BACKGROUND.float().double().expand(28, 40, 3))
    assert all(not image.any() for name, image in got.images.items() if name != "color")
    assert all(not gradient.any() for gradient in got.gradients.values())
    assert got.radii is not None and not got.radii.any()


@on_every_kernel
@on_both_branches
def test_one_splat(machine: Machine, branch: str) -> None:
    compare(machine, branch, before_camera(branch, 1, seed=3, size=0.5), facing_camera())


@on_every_kernel
@on_both_branches
def test_the_background_shines_through_by_what_is_left(machine: Machine, branch: str) -> None:
    splats = before_camera(branch, 20, size=0.5)
    got, expected = render(machine, branch, splats, facing_camera()), brute_force(branch, splats, facing_camera())
    splats["colors"][:] = 0
    dark = render(machine, branch, splats, facing_camera())
    left = (1 - got.images["alpha"])[..., None] * BACKGROUND
    assert (dark.images["color"] - left).abs().max() < 1e-6
    assert (got.images["color"] - expected.images["color"]).abs().max() < STEEP["images"]
