"""Dataclasses as the rows of a CSV file, a column for each field."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

T = TypeVar("T")


def write_csv(path: Path, kind: type[T], rows: Sequence[T], digits: int) -> None:
    """Write the rows, in the order of the fields of the dataclass `kind`.

    digits: of each float; None is written as nothing.
    """
    columns = list(get_type_hints(kind))
    with open(path, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows([_text(getattr(row, name), digits) for name in columns] for row in rows)


def read_csv(path: Path, kind: type[T]) -> list[T]:
    """Read what `write_csv` wrote; no rows where there is no file."""
    if not path.is_file():
        return []
    kinds = get_type_hints(kind)
    with open(path, newline="", encoding="utf-8") as file:
        return [kind(**{name: _value(text, kinds[name]) for name, text in row.items()}) for row in csv.DictReader(file)]


def _text(value: Any, digits: int) -> str:
    if value is None:
        return ""
    return f"{value:.{digits}g}" if isinstance(value, float) else str(value)


def _value(text: str, kind: Any) -> Any:
    if kind is str:
        return text
    if text == "":
        return None
    return int(text) if kind in (int, int | None) else float(text)
