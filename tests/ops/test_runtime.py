"""Settings that hold for all kernel families."""

from __future__ import annotations

import pytest

from mgsr.errors import ConfigError
from mgsr.native import (
    _adam,
    _environment_map,
    _fusion,
    _gaussians,
    _harmonics,
    _image,
    _lights,
    _mirrored,
    _stereo,
    _surfels,
    _terms,
    runtime,
)

FAMILIES = (
    _adam,
    _environment_map,
    _fusion,
    _gaussians,
    _harmonics,
    _image,
    _lights,
    _mirrored,
    _stereo,
    _surfels,
    _terms,
)
pytestmark = pytest.mark.usefixtures("kernel_settings_come_back")


def test_every_family_follows() -> None:
    for isa in runtime.isas():
        runtime.set_isa(isa)
        runtime.set_threads(3)
        assert all(family.isa() == isa and family.threads() == 3 for family in FAMILIES)


def test_zero_threads_means_all_processors() -> None:
    runtime.set_threads(0)
    assert all(family.threads() >= 1 for family in FAMILIES)


def test_bad_settings_are_named() -> None:
    with pytest.raises(ConfigError, match="isa"):
        runtime.set_isa("mmx")
    with pytest.raises(ConfigError, match="threads"):
        runtime.set_threads(-1)
