"""A long training on a tiny scene: nothing drifts. `benchmarks/long_run.py` makes ten times as many iterations."""

from __future__ import annotations

import pytest

from tests.stability.long_training import MOST_SPLATS, Look, growth, long_training


def assert_sound(look: Look) -> None:
    assert look.not_finite == look.incidents == 0, look
    assert 0 < look.surfels <= MOST_SPLATS and 0 < look.gaussians <= MOST_SPLATS, look
    # Far from where a quaternion's square leaves float32, or exp of a logit.
    assert 1e-3 < look.shortest_quat <= look.longest_quat < 1e3, look
    assert look.largest_logit < 30 and look.largest_parameter < 1e3 and look.largest_moment < 1e3, look


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_nothing_drifts_in_five_thousand_iterations() -> None:
    looks = long_training(5000, side=24)
    assert looks[-1].done == 5000
    for look in looks:
        assert_sound(look)
    # The mutual phase holds all that there is: in it memory stands still, to 2 MiB.
    mutual = [look.memory for look in looks if look.stage == "mutual"]
    assert max(mutual[3:]) - min(mutual[3:]) < 2, growth(looks)
    psnrs = [look.psnr for look in looks if look.stage == "mutual"]
    assert min(psnrs[1:]) > max(psnrs) - 6
