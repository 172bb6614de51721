"""The compiled variants of a kernel family and its thread count, set for the length of a block."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType

from mgsr.native import _image

ISAS: list[str] = _image.isas()


@contextmanager
def variant(family: ModuleType, isa: str | None = None, threads: int | None = None) -> Iterator[None]:
    """Use one variant, one thread count, or both; what was set before comes back."""
    isa_before, threads_before = family.isa(), family.threads()
    family.set_isa(isa or isa_before)
    family.set_threads(threads or threads_before)
    try:
        yield
    finally:
        family.set_isa(isa_before)
        family.set_threads(threads_before)
