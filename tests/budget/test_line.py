"""The line on which the presets are points."""

from __future__ import annotations

from dataclasses import replace

import pytest

from mgsr.budget.line import SettingsLine, interpolated
from mgsr.config import METHODS, PRESETS, make_config
from mgsr.config.expert import BudgetOptions

LOWEST, HIGHEST = BudgetOptions().lowest, BudgetOptions().highest


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("place", "preset"), list(enumerate(PRESETS)))
def test_presets_are_points_on_it(place: int, preset: str, method: str) -> None:
    found = SettingsLine(make_config("standard", method)).at(place)
    assert replace(found, preset=preset) == make_config(preset, method)


def test_what_the_caller_has_set_stays() -> None:
    line = SettingsLine(make_config(overrides=["mesh.poisson_depth=5", "surfels.max_start=777", "seed=3"]))
    for place in (LOWEST, 0.4, HIGHEST):
        config = line.at(place)
        assert (config.mesh.poisson_depth, config.train.surfels.max_start, config.seed) == (5, 777, 3)


def test_the_preset_that_is_named_does_not_matter() -> None:
    found = {replace(SettingsLine(make_config(preset)).at(0.6), preset="") for preset in PRESETS}
    assert len(found) == 1


def test_it_rises() -> None:
    configs = [SettingsLine(make_config()).at(place) for place in (LOWEST, -0.2, 0.0, 0.3, 1.0, 1.7, HIGHEST)]
    counts = [config.train.gaussians.max_start for config in configs]
    assert counts == sorted(set(counts))
    lengths = [config.train.mutual.iterations for config in configs]
    assert lengths == sorted(lengths)
    assert len(set(lengths[:5])) == 5, "from draft to standard training gets longer"


def test_between_two_numbers_lies_their_mean_in_ratio() -> None:
    assert interpolated([100, 400, 400], 0.5) == 200
    assert interpolated([1.0, 4.0, 9.0], 1.5) == pytest.approx(6.0)
    assert interpolated([100, 200, 400], -1.0) == 50
    assert [interpolated([None, 0.85, 0.85], place) for place in (-0.5, 0.0, 0.01, 0.4)] == [None, None, 0.85, 0.85]
    assert [interpolated([0, 150, 150], place) for place in (0.4, 0.6, 1.0)] == [0, 150, 150]
    assert interpolated([None, 0.85, 0.85], 1.7) == 0.85
