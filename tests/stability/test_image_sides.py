"""Images of one pixel, around the tile and very wide ones."""

from __future__ import annotations

import pytest

from tests.cuda.machines import Machine, on_every_kernel
from tests.stability.branches import before_camera, compare, facing_camera, held, on_both_branches

SIDES = [(1, 1), (1, 17), (15, 16), (16, 15), (17, 17)]


@on_every_kernel
@on_both_branches
@pytest.mark.parametrize(("width", "height"), SIDES)
def test_sides_around_the_tile(machine: Machine, branch: str, width: int, height: int) -> None:
    compare(machine, branch, before_camera(branch, 12, size=0.5), facing_camera(width, height))


@on_every_kernel
@on_both_branches
@pytest.mark.parametrize(("width", "height"), [(4096, 1), (3, 4096)])
def test_very_long_images(machine: Machine, branch: str, width: int, height: int) -> None:
    """Check splats across all of a very long image.

    They reach out to pixel 4096, where float32 has eleven bits left for a part of one.
    """
    splats = before_camera(branch, 12, size=0.2)
    splats["means"][:, 0] *= width / 2000
    splats["means"][:, 1] *= height / 2000
    compare(machine, branch, held(splats), facing_camera(width, height, focal=2000.0))
