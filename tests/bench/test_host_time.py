"""What an iteration on a GPU asks of the host: few operations of torch's, beside the launches."""

from __future__ import annotations

import pytest

from benchmarks.host_time import IdleLauncher, Row, measure
from mgsr.config import make_config
from mgsr.native.cuda.tiles import ListParams
from mgsr.training.plan import make_plan
from tests.training.ball import ball_points, ball_scene


def rows(*overrides: str) -> list[Row]:
    config = make_config("high", overrides=["environment_map.iterations=0", *overrides])
    return measure(make_plan(ball_scene(24, train=3, test=1, masked=True), ball_points(80), config), config, 2)


@pytest.mark.parametrize("reflection", ["shared", "both"])
def test_an_iteration_has_few_operations(reflection: str) -> None:
    """Check the number of torch's operations in an iteration, so that one that creeps in shows.

    With both lights it is 22 in the mutual phase, of which 9 make the tiles' lists. None waits for a number, which
    would be called item.
    """
    surfels, gaussians, mutual = rows(f"reflection={reflection}")
    assert (surfels.stage, gaussians.stage, mutual.stage) == ("warmup_surfels", "warmup_gaussians", "mutual")
    assert surfels.operations.total() <= 15 and gaussians.operations.total() <= 20 and mutual.operations.total() <= 30
    assert mutual.launches <= 65
    for row in (surfels, gaussians, mutual):
        assert not {"item", "_local_scalar_dense"} & row.operations.keys()
        assert row.milliseconds > 0


def test_the_idle_launcher_counts() -> None:
    launcher = IdleLauncher()
    launcher.launch("tiles", "tiles_list", 1, 1, ListParams())
    assert launcher.launched == 1
