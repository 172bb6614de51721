"""Options of algorithms: frozen dataclasses of numbers, each with a valid range that is checked."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import Annotated, Any, get_type_hints

from mgsr.errors import ConfigError


@dataclass(frozen=True)
class Range:
    """The valid values of a number: from `least` to `most`, without `least` itself if it is `open`."""

    least: float = 0
    most: float = math.inf
    open: bool = False

    def holds(self, value: float) -> bool:
        """Return whether a number is finite and within the range."""
        above = value > self.least if self.open else value >= self.least
        return above and value <= self.most and value < math.inf

    def __str__(self) -> str:
        if self.most == math.inf:
            return f"above {self.least:g}" if self.open else f"{self.least:g} or more"
        return f"above {self.least:g}, up to {self.most:g}" if self.open else f"{self.least:g} to {self.most:g}"


@dataclass(frozen=True)
class Pattern:
    """The form of a text: a regular expression that all of it must match, and an example."""

    regex: str
    example: str


Count = Annotated[int, Range(1)]
WholeNumber = Annotated[int, Range(0)]
Positive = Annotated[float, Range(0, open=True)]
NotNegative = Annotated[float, Range(0)]
Share = Annotated[float, Range(0, 1)]  # also for cosines, and for sRGB 0..1
Angle = Annotated[float, Range(0, 180)]  # degrees


@dataclass(frozen=True)
class Options:
    """The options of an algorithm. A field with a `Range` in its type refuses other values with a ConfigError."""

    def __post_init__(self) -> None:
        for name, valid in ranges(type(self)).items():
            value = getattr(self, name)
            if not valid.holds(value):
                raise ConfigError(f"{name}: expected {valid}, got {value:g}")

    def require_order(self, *names: str) -> None:
        """Raise ConfigError unless the fields with these names increase strictly."""
        values = [getattr(self, name) for name in names]
        if not all(low < high for low, high in pairwise(values)):
            raise ConfigError(f"{names[0]}: expected {' < '.join(names)}, got {', '.join(f'{v:g}' for v in values)}")


def ranges(kind: type) -> Mapping[str, Range]:
    """Return the valid range of each field of a dataclass that has one."""
    return {name: mark for name, mark in marks(kind).items() if isinstance(mark, Range)}


def marks(kind: type) -> Mapping[str, Range | Pattern]:
    """Return the range or the pattern of each field of a dataclass that has one."""
    return _marks(kind)


@cache
def _marks(kind: Any) -> Mapping[str, Range | Pattern]:
    """Return `marks`, which are read from the annotations only once."""
    hints = get_type_hints(kind, include_extras=True)
    found = {name: getattr(hint, "__metadata__", ()) for name, hint in hints.items()}
    return {name: part for name, parts in found.items() for part in parts if isinstance(part, Range | Pattern)}
