"""Print the settings of mgsr/config as Markdown tables of name, default and meaning, which is the comment there.

python scripts/options_page.py
"""

from __future__ import annotations

import dataclasses
import inspect
import re
import sys
from enum import Enum, StrEnum
from pathlib import Path
from typing import Any, get_args, get_type_hints

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from mgsr.config import ABLATIONS, METHODS, PRESETS, Config
from mgsr.config.options import ranges
from worker.comments import field_comments

PAPER, EXPERT = "train.paper", "expert"


def settings_markdown() -> str:
    """Return a heading and a table for each group of user settings, then the changes by presets and methods."""
    apart = (PAPER, EXPERT)
    parts = [_group(prefix, node) for prefix, node in _groups(Config()) if prefix and not prefix.startswith(apart)]
    return "\n\n".join([*parts, _rows("presets", PRESETS), _rows("methods", METHODS)])


def paper_markdown() -> str:
    """Return the table of the settings that only reproduce the paper's rows, then the changes of each row."""
    return "\n\n".join([_group(PAPER, Config().train.paper), _rows("rows of the paper's ablation", ABLATIONS)])


def expert_markdown() -> str:
    """Return a heading and a table for each group of the algorithms' options."""
    return "\n\n".join(_group(prefix, node) for prefix, node in _groups(Config().expert, EXPERT))


def _groups(node: Any, prefix: str = "") -> list[tuple[str, Any]]:
    """Return every nested dataclass with its dotted path, outer ones first."""
    found = [(prefix, node)]
    for field in dataclasses.fields(node):
        value = getattr(node, field.name)
        if dataclasses.is_dataclass(value):
            found += _groups(value, f"{prefix}.{field.name}".lstrip("."))
    return found


def _group(prefix: str, node: Any) -> str:
    hints, comments = get_type_hints(type(node)), field_comments(type(node))
    valid = ranges(type(node))
    head = "| setting | default | valid | meaning |" if valid else "| setting | default | meaning |"
    lines = [f"### `{prefix}`", "", inspect.getdoc(type(node)) or "", "", head, re.sub(r"[^|]+", "---", head)]
    for field in dataclasses.fields(node):
        value = getattr(node, field.name)
        if not dataclasses.is_dataclass(value):
            meaning = " ".join(filter(None, (comments.get(field.name), _choices(hints[field.name]))))
            cells = [f"`{field.name}`", f"`{_shown(value)}`", *([str(valid.get(field.name, ""))] if valid else [])]
            lines.append(f"| {' | '.join(cells)} | {meaning.replace('|', '&#124;')} |")
    return "\n".join(lines) if len(lines) > 6 else "\n".join(lines[:3])


def _choices(kind: Any) -> str:
    """Return the values of an enum with their meanings, from its docstring."""
    for part in (kind, *get_args(kind)):
        if inspect.isclass(part) and issubclass(part, StrEnum):
            names = ", ".join(f"`{member}`" for member in part)
            return f"One of {names}. {' '.join((inspect.getdoc(part) or '').split())}"
    return ""


def _shown(value: Any) -> str:
    if isinstance(value, bool):
        return "on" if value else "off"
    return "none" if value is None else str(value.value if isinstance(value, Enum) else value)


def _rows(title: str, table: dict[str, dict[str, str]]) -> str:
    """Return a table of the settings that each name of PRESETS, METHODS or ABLATIONS changes."""
    lines = [f"### What the {title} set", "", "| | |", "|---|---|"]
    lines += [
        f"| `{name}` | {', '.join(f'`{key}={value}`' for key, value in changed.items()) or 'the defaults'} |"
        for name, changed in table.items()
    ]
    return "\n".join(lines)


if __name__ == "__main__":
    print(settings_markdown(), paper_markdown(), expert_markdown(), sep="\n\n")
