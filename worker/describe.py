"""Write a description of the library's settings to service/contract/library.json, so that the service needs no library.

Run `python -m worker.describe` after each change of mgsr/config or of the version.
"""

from __future__ import annotations

import inspect
import json
import math
import types
from enum import StrEnum
from pathlib import Path
from typing import Any, Union, get_args, get_origin

from mgsr import __version__
from mgsr.config import METHODS, PRESETS, RENAMED, Config, field_types
from mgsr.config.options import Pattern, Range, marks
from service import contract
from worker.comments import field_comments

LIBRARY = Path(contract.__file__).with_name("library.json")


def describe_library() -> dict[str, Any]:
    """Return version, presets, methods, renamed settings, and a JSON schema of every setting.

    A schema has the setting's meaning, from the comments in mgsr/config, and its default in the preset standard.
    """
    defaults = Config()
    settings = {
        path: _schema(kind, _valid(defaults, path))
        | _meaning(defaults, path, kind)
        | {"default": _value(defaults, path)}
        for path, kind in field_types(defaults).items()
        if path not in ("preset", "method", "seed")
    }
    tables = {"presets": PRESETS, "methods": METHODS, "renamed": RENAMED}
    return {"version": __version__, **tables, "settings": settings}


def as_text(library: dict[str, Any]) -> str:
    """Return the description as the file's JSON text."""
    return json.dumps(library, indent=1) + "\n"


def _valid(defaults: Config, path: str) -> Range | Pattern:
    """Return the valid values of a number or a string. No setting may be negative (`mgsr.config.validate`)."""
    group, _, name = path.rpartition(".")
    return marks(type(_value(defaults, group))).get(name, Range())


def _schema(kind: Any, valid: Range | Pattern) -> dict[str, Any]:
    if get_origin(kind) in (Union, types.UnionType):
        inner = next(part for part in get_args(kind) if part is not type(None))
        return {"anyOf": [_schema(inner, valid), {"type": "null"}]}
    if issubclass(kind, StrEnum):
        return {"type": "string", "enum": [str(member) for member in kind]}
    if isinstance(valid, Pattern):
        return {"type": "string", "pattern": f"^({valid.regex})$", "examples": [valid.example]}
    if kind in (int, float):
        least = {"exclusiveMinimum" if valid.open else "minimum": valid.least}
        most = {} if valid.most == math.inf else {"maximum": valid.most}
        return {"type": {int: "integer", float: "number"}[kind], **least, **most}
    return {"type": {bool: "boolean", str: "string"}[kind]}


def _meaning(defaults: Config, path: str, kind: Any) -> dict[str, str]:
    """Return the setting's comment, followed by the meaning of each member of an enum."""
    group, _, name = path.rpartition(".")
    texts = [field_comments(type(_value(defaults, group))).get(name, "")]
    texts += [" ".join((inspect.getdoc(part) or "").split()) for part in (kind, *get_args(kind)) if _is_choice(part)]
    said = " ".join(filter(None, texts))
    return {"description": said} if said else {}


def _is_choice(kind: Any) -> bool:
    return inspect.isclass(kind) and issubclass(kind, StrEnum)


def _value(node: Any, path: str) -> Any:
    for part in filter(None, path.split(".")):
        node = getattr(node, part)
    return node


if __name__ == "__main__":
    LIBRARY.write_text(as_text(describe_library()), encoding="utf-8")
