"""The order of splats along Morton's curve."""

from __future__ import annotations

import torch

from mgsr.gaussians.order import morton_order


def test_the_curve_visits_the_corners_of_a_cube_in_its_order() -> None:
    corners = torch.tensor([[x, y, z] for z in (0.0, 1.0) for y in (0.0, 1.0) for x in (0.0, 1.0)])
    shuffled = torch.randperm(8, generator=torch.Generator().manual_seed(3))
    assert torch.equal(shuffled[morton_order(corners[shuffled])], torch.arange(8))


def test_neighbours_in_memory_are_near_in_space() -> None:
    points = torch.rand(4000, 3, generator=torch.Generator().manual_seed(0))
    order = morton_order(points)
    assert torch.equal(order.sort().values, torch.arange(4000))
    apart = (points[order][1:] - points[order][:-1]).norm(dim=1).mean()
    assert apart < 0.2 * (points[1:] - points[:-1]).norm(dim=1).mean()


def test_odd_points_do_not_break_it() -> None:
    assert morton_order(torch.zeros(0, 3)).tolist() == []
    assert morton_order(torch.ones(3, 3)).tolist() == [0, 1, 2]
    assert sorted(morton_order(torch.tensor([[0.0, torch.nan, 1.0], [1.0, 1.0, torch.inf]])).tolist()) == [0, 1]
