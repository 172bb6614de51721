"""A run's settings from a preset, a method and overrides."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from mgsr.config.overrides import apply_overrides, override_texts
from mgsr.config.paper import ABLATIONS
from mgsr.config.run import METHODS, PRESETS, Config
from mgsr.config.validation import validate
from mgsr.errors import ConfigError


def make_config(
    preset: str = "standard",
    method: str = "mgsr",
    seed: int = 0,
    overrides: Mapping[str, object] | Sequence[str] = (),
) -> Config:
    """Make the settings of a run from a preset, a method and overrides, applied in that order.

    overrides: settings by name, such as ``{"masks": "off", "mesh.max_faces": 50_000}``, or ``key=value`` texts.

    A key is a field's full path (``train.mutual.depth_weight``) or any part of it that names one field alone
    (``masks``, ``surfels.densify.every``). Values are read as the field's type; ``none`` where the field allows it.

    Raises ConfigError for an unknown preset, method, key or value, and suggests the nearest names.
    """
    config = Config(preset=_known("preset", preset, PRESETS), method=_known("method", method, METHODS), seed=seed)
    for row in (PRESETS[preset], METHODS[method]):
        config = apply_overrides(config, [f"{key}={value}" for key, value in row.items()])
    config = apply_overrides(config, override_texts(overrides))
    validate(config)
    return config


def ablation_overrides(row: str) -> list[str]:
    """Return the ``key=value`` overrides of one ablation row, A to N. Raises ConfigError for another name."""
    return [f"{key}={value}" for key, value in ABLATIONS[_known("ablation", row, ABLATIONS)].items()]


def _known(kind: str, name: str, table: Mapping[str, Any]) -> str:
    if name not in table:
        raise ConfigError(f"{kind} {name!r}: expected one of {', '.join(table)}")
    return name
