"""Settings that hold for all kernel families."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

import pytest

from mgsr.errors import ConfigError
from mgsr.native import runtime

# Every stub is that of a family.
STUBS = Path(runtime.__file__).parent.glob("_*.pyi")
FAMILIES = [import_module(f"mgsr.native.{path.stem}") for path in STUBS]
pytestmark = pytest.mark.usefixtures("kernel_settings_come_back")


def test_every_family_follows() -> None:
    assert len(FAMILIES) == len(runtime.FAMILIES)
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
