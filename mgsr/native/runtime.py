"""Settings of the native kernels that apply to all families."""

from __future__ import annotations

from types import ModuleType

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
)

FAMILIES: tuple[ModuleType, ...] = (
    _gaussians,
    _surfels,
    _image,
    _harmonics,
    _adam,
    _environment_map,
    _stereo,
    _fusion,
    _mirrored,
    _terms,
    _lights,
)


def set_threads(n: int) -> None:
    """Let the kernels use ``n`` threads; 0 means all processors of this process. Results don't depend on it.

    Raises ConfigError for a negative number.
    """
    if n < 0:
        raise ConfigError(f"threads: expected 0 (all processors) or more, got {n}")
    for family in FAMILIES:
        family.set_threads(n)


def isas() -> list[str]:
    """Return the compiled variants that this processor can run, fastest first: avx512, avx2, baseline."""
    return list(_image.isas())


def set_isa(name: str) -> None:
    """Use one compiled variant in all families. Results differ between variants by rounding only.

    Raises ConfigError for a variant that this processor does not run.
    """
    if name not in isas():
        raise ConfigError(f"isa: expected one of {', '.join(isas())}, got {name}")
    for family in FAMILIES:
        family.set_isa(name)
