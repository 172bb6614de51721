"""Settings: presets, methods, ablation rows and overrides."""

from __future__ import annotations

import pytest

from mgsr.config import (
    ABLATIONS,
    METHODS,
    PRESETS,
    Branches,
    Masks,
    Reflection,
    StopRule,
    Teaching,
    ablation_overrides,
    make_config,
)
from mgsr.errors import ConfigError


def test_bare_and_dotted_keys() -> None:
    config = make_config(overrides=["masks=off", "surfels.densify.every=50", "train.mutual.depth_weight=0.2"])
    assert config.data.masks is Masks.OFF
    assert config.train.surfels.densify.every == 50
    assert config.train.gaussians.densify.every != 50
    assert config.train.mutual.depth_weight == 0.2


def test_optional_and_switch_values() -> None:
    config = make_config(overrides=["surfels.densify.reset_every=300", "tv=no"])
    assert config.train.surfels.densify.reset_every == 300
    assert config.train.paper.tv is False
    again = make_config(overrides=["surfels.densify.reset_every=300", "surfels.densify.reset_every=none"])
    assert again.train.surfels.densify.reset_every is None


def test_later_rows_win() -> None:
    config = make_config("draft", "mgsr", 3, ["mutual.iterations=7"])
    assert (config.preset, config.seed, config.train.mutual.iterations) == ("draft", 3, 7)
    assert config.train.warmup.surfel_iterations == int(PRESETS["draft"]["warmup.surfel_iterations"])


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("method", METHODS)
def test_every_preset_and_method_is_valid(preset: str, method: str) -> None:
    make_config(preset, method)


@pytest.mark.parametrize("row", ABLATIONS)
def test_every_ablation_row_is_valid(row: str) -> None:
    make_config(overrides=ablation_overrides(row))


def test_ablation_rows_mean_what_the_paper_says() -> None:
    assert make_config(overrides=ablation_overrides("A")).train.branches is Branches.GAUSSIANS
    assert make_config(overrides=ablation_overrides("A")).train.gaussians.reflection is Reflection.OWN
    assert make_config(overrides=ablation_overrides("K")).train.paper.teaching is Teaching.ONE_WAY
    assert make_config(overrides=ablation_overrides("L")).train.paper.stop_rule is StopRule.NONE
    assert not make_config(overrides=ablation_overrides("N")).train.paper.tv
    assert make_config(method="3dgs").train.gaussians.reflection is Reflection.OFF


@pytest.mark.parametrize(
    ("override", "part"),
    [
        ("maks=off", "data.masks"),
        ("mutal.iterations=3", "train.mutual.iterations"),
        ("every=3", "ambiguous"),
        ("volumes.max_start=9", "use 'gaussians.max_start'"),
        ("warmup.stop_rule=none", "use 'paper.stop_rule'"),
        ("train.volumes.depth_tv_weight=1", "use 'train.paper.gaussian_depth_tv_weight'"),
        ("surfels.rates.final=1", "use 'surfels.rates.final_factor'"),
        ("masks=perhaps", "auto, object, ignore, off"),
        ("mutual.iterations=many", "a whole number"),
        ("tv=perhaps", "on or off"),
        ("reflection=perhaps", "auto, off, own, shared, both"),
        ("mutual.iterations", "key=value"),
        ("mutual.iterations=-1", "at least 0"),
        ("bilateral_angle=nan", "a finite number"),
        ("bilateral_angle=inf", "a finite number"),
        ("surfels.sh_degree=4", "0 to 3"),
        ("surfels.densify.prune_contribution=1", "share below 1"),
        ("start_weight=1", "between 0 and 1"),
        ("report_every=0", "at least 1"),
        ("surfels.rates.position=0", "more than 0"),
    ],
)
def test_errors_name_the_cure(override: str, part: str) -> None:
    with pytest.raises(ConfigError, match=part):
        make_config(overrides=[override])


def test_what_the_surface_mirrors_needs_a_surface() -> None:
    with pytest.raises(ConfigError, match=r"=\w+ needs both branches, got train\.branches=gaussians"):
        make_config(overrides=["branches=gaussians", "reflection=shared"])


def test_unknown_names() -> None:
    with pytest.raises(ConfigError, match="draft, standard, high"):
        make_config("quick")
    with pytest.raises(ConfigError, match="mgsr, 2dgs, 3dgs"):
        make_config(method="nerf")
