"""The line of settings, on which a place is a number: the preset draft is at 0, standard at 1, high at 2.

Numbers are interpolated geometrically between two presets, and extrapolated below draft. A setting that is not a
number, or is 0 for none, comes from the nearest preset. A part that a preset lacks begins just above that preset.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from mgsr.config import PRESETS, Config, field_types, make_config
from mgsr.config.overrides import value_at

JUST_ABOVE_DRAFT = 0.01  # the place at which steps begin that draft lacks


class SettingsLine:
    """The line of settings for one run.

    Settings that the caller changed from the preset's and the method's stay fixed along the line.
    """

    def __init__(self, config: Config) -> None:
        self._config = config
        asked = make_config(config.preset, config.method)
        presets = [make_config(name, config.method) for name in PRESETS]
        self._values = {
            path: [value_at(preset, path) for preset in presets]
            for path in field_types(config)
            if len({value_at(preset, path) for preset in presets}) > 1
            and value_at(config, path) == value_at(asked, path)
        }
        # The values include the presets' own names.
        self._values.pop("preset", None)

    def at(self, place: float) -> Config:
        """Return the settings at a place."""
        config = self._config
        for path, values in self._values.items():
            config = _with(config, path.split("."), interpolated(values, place))
        return config


def interpolated(values: list[Any], place: float) -> Any:
    """Interpolate the values of the points 0, 1, 2 at a place on the line."""
    if None in values:
        return values[min(max(math.ceil(place), 0), len(values) - 1)]
    if not all(isinstance(value, (int, float)) and not isinstance(value, bool) and value > 0 for value in values):
        return values[min(max(round(place), 0), len(values) - 1)]
    first = min(max(int(place // 1), 0), len(values) - 2)
    low, high = values[first], values[first + 1]
    between = low * (high / low) ** (place - first)
    return max(1, round(between)) if isinstance(low, int) else between


def _with(node: Any, path: list[str], value: Any) -> Any:
    head, *rest = path
    return replace(node, **{head: _with(getattr(node, head), rest, value) if rest else value})
