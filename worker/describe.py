"""Writes what the library's settings are to service/contract/library.json, so that the service needs no library.

python -m worker.describe, after each change of mgsr/config.py or of the version.
"""

from __future__ import annotations

import json
import types
from enum import StrEnum
from pathlib import Path
from typing import Any, Union, get_args, get_origin

from mgsr import __version__
from mgsr.config import METHODS, PRESETS, Config, field_types
from service import contract

LIBRARY = Path(contract.__file__).with_name("library.json")


def describe_library() -> dict[str, Any]:
    """Version, presets, methods, and a JSON schema of every single setting with its default in the preset standard."""
    defaults = Config()
    settings = {
        path: _schema(kind) | {"default": _default(defaults, path)}
        for path, kind in field_types(defaults).items()
        if path not in ("preset", "method", "seed")
    }
    return {"version": __version__, "presets": PRESETS, "methods": METHODS, "settings": settings}


def as_text(library: dict[str, Any]) -> str:
    """The file's content."""
    return json.dumps(library, indent=1) + "\n"


def _schema(kind: Any) -> dict[str, Any]:
    if get_origin(kind) in (Union, types.UnionType):
        inner = next(part for part in get_args(kind) if part is not type(None))
        return {"anyOf": [_schema(inner), {"type": "null"}]}
    if issubclass(kind, StrEnum):
        return {"type": "string", "enum": [str(member) for member in kind]}
    if kind in (int, float):  # no setting may be negative: mgsr.config.validate
        return {"type": {int: "integer", float: "number"}[kind], "minimum": 0}
    return {"type": {bool: "boolean", str: "string"}[kind]}


def _default(node: Any, path: str) -> Any:
    for part in path.split("."):
        node = getattr(node, part)
    return node


if __name__ == "__main__":
    LIBRARY.write_text(as_text(describe_library()), encoding="utf-8")
