"""The input formats: every module in this folder defines one as ``FORMAT``."""

from __future__ import annotations

import importlib
import pkgutil

from mgsr.data.capture import Format


def all_formats() -> list[Format]:
    """Return every format, in the order in which they are tried."""
    modules = (importlib.import_module(f"{__name__}.{found.name}") for found in pkgutil.iter_modules(__path__))
    return sorted((module.FORMAT for module in modules), key=lambda kind: (kind.rank, kind.name))
