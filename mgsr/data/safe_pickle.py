"""Read arrays from pickle files safely.

A pickle is a program that can import and call any function and demand any amount of memory. This module allows only the
instructions that arrays in tuples and lists need. It replaces numpy's constructors in the pickle by its own classes,
which only store their arguments.
"""

from __future__ import annotations

import io
import math
import pickle
import pickletools
from pathlib import Path
from typing import Any

import numpy as np

from mgsr.data.odd_files import require_content
from mgsr.errors import SceneError, in_short

_LARGEST_FILE = 1 << 16
_LARGEST_MEMO = 1 << 10  # pickle makes its table of remembered objects as long as the largest index
_INSTRUCTIONS = frozenset(
    (
        *("PROTO", "FRAME", "STOP", "MARK", "POP", "GLOBAL", "STACK_GLOBAL", "REDUCE", "BUILD"),
        *("NONE", "NEWTRUE", "NEWFALSE", "INT", "BININT", "BININT1", "BININT2", "LONG", "LONG1", "FLOAT", "BINFLOAT"),
        *("STRING", "BINSTRING", "SHORT_BINSTRING", "UNICODE", "BINUNICODE", "SHORT_BINUNICODE"),
        *("BINBYTES", "SHORT_BINBYTES", "BYTEARRAY8", "EMPTY_TUPLE", "TUPLE", "TUPLE1", "TUPLE2", "TUPLE3"),
        *("EMPTY_LIST", "LIST", "APPEND", "APPENDS"),
        *("PUT", "BINPUT", "LONG_BINPUT", "GET", "BINGET", "LONG_BINGET", "MEMOIZE"),
    )
)
_INDEXED = ("PUT", "BINPUT", "LONG_BINPUT")
_DAMAGE = (
    ArithmeticError,
    AttributeError,
    EOFError,
    ImportError,
    LookupError,
    MemoryError,
    NotImplementedError,
    RecursionError,
    TypeError,
    ValueError,
    pickle.UnpicklingError,
)


def read_pickled_arrays(path: Path, source: str) -> list[np.ndarray]:
    """Read the numeric arrays [...], float64, of a pickled tuple or list. The file's callables are never called.

    Raises SceneError, naming `source`, for anything else and for files over 64 KiB.
    """
    require_content(path)
    try:
        data = path.read_bytes() if path.stat().st_size <= _LARGEST_FILE else b""
        if not data:
            raise ValueError(f"expected a file of at most {_LARGEST_FILE} bytes")
        _check_instructions(data)
        content = _Unpickler(io.BytesIO(data), encoding="latin-1").load()
        if not isinstance(content, (tuple, list)):
            raise ValueError("expected a tuple")
        return [_array(item) for item in content]
    except (OSError, *_DAMAGE) as error:
        reason = in_short(error) or type(error).__name__
        raise SceneError(f"{source}: expected a pickled tuple of numeric arrays: {reason}; copy it again") from error


def _check_instructions(data: bytes) -> None:
    for instruction, argument, _ in pickletools.genops(data):
        if instruction.name not in _INSTRUCTIONS:
            raise ValueError(f"the instruction {instruction.name}, which no array needs, is refused")
        if instruction.name in _INDEXED and not 0 <= (argument or 0) < _LARGEST_MEMO:
            raise ValueError(f"{instruction.name} {argument} is refused")


class _Kept:
    """A record of an object's constructor arguments and of its state."""

    def __init__(self, *arguments: Any) -> None:
        self.arguments = arguments
        self.state: Any = ()

    def __setstate__(self, state: Any) -> None:
        if not isinstance(self, _Kept) or not isinstance(state, tuple):
            raise ValueError("the state belongs to no array")
        self.state = state


class _Name(_Kept):
    """numpy.ndarray, which is named but never called."""


class _Array(_Kept):
    """numpy's _reconstruct, whose state is (version, shape, dtype, by columns, bytes)."""


class _Buffer(_Kept):
    """numpy's _frombuffer of protocol 5, whose arguments are (bytes, dtype, shape, "C" or "F")."""


class _Dtype(_Kept):
    """numpy.dtype: its first argument is "f8"; the second item of its state is the byte order."""


class _Scalar(_Kept):
    """numpy's scalar: dtype and bytes."""


class _LatinBytes(_Kept):
    """codecs.encode: bytes that protocol 2 writes as text of latin-1."""


_MADE = {
    ("numpy", "ndarray"): _Name,
    ("numpy", "dtype"): _Dtype,
    ("numpy.core.multiarray", "_reconstruct"): _Array,
    ("numpy._core.multiarray", "_reconstruct"): _Array,
    ("numpy.core.multiarray", "scalar"): _Scalar,
    ("numpy._core.multiarray", "scalar"): _Scalar,
    ("numpy.core.numeric", "_frombuffer"): _Buffer,
    ("numpy._core.numeric", "_frombuffer"): _Buffer,
    ("_codecs", "encode"): _LatinBytes,
}


class _Unpickler(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        """Return the stand-in of a class. Raises pickle.UnpicklingError for one that no array needs."""
        if (module, name) not in _MADE:
            raise pickle.UnpicklingError(f"{module[:80]}.{name[:80]} is refused because it is not part of an array")
        return _MADE[module, name]


def _array(item: Any) -> np.ndarray:
    """Return an item as an array [...]: the item is an array's state, a scalar, a number, or nested lists of numbers.

    Raises ValueError for others.
    """
    if isinstance(item, _Array):
        _, shape, dtype, by_columns, data = item.state
        return _from_bytes(dtype, shape, bool(by_columns), data)
    if isinstance(item, _Buffer):
        data, dtype, shape, order = item.arguments
        return _from_bytes(dtype, shape, order == "F", data)
    if isinstance(item, _Scalar):
        dtype, data = item.arguments
        return _from_bytes(dtype, (), False, data)
    if isinstance(item, (list, tuple)):
        return _from_list(item)
    raise ValueError(f"expected an array, got {type(item).__name__}")


def _from_list(rows: list[Any] | tuple[Any, ...]) -> np.ndarray:
    """Convert a list of numbers, or of lists of numbers, to an array [N] or [M,N], float64.

    It goes no deeper, as a list may contain itself.

    Raises ValueError for items that are not numbers.
    """
    for item in rows:
        for value in item if isinstance(item, (list, tuple)) else [item]:
            if isinstance(value, bool) or not isinstance(value, (int, float)):
                raise ValueError(f"expected a number, got {type(value).__name__}")
    return np.array(rows, np.float64)


def _from_bytes(dtype: Any, shape: Any, by_columns: bool, data: Any) -> np.ndarray:
    """Return an array of a shape, float64, from its raw bytes. Raises ValueError where their number is wrong."""
    if isinstance(data, _LatinBytes):
        data = data.arguments[0]
    content = data.encode("latin-1") if isinstance(data, str) else data
    if (
        not isinstance(content, (bytes, bytearray))
        or not isinstance(shape, tuple)
        or not all(type(side) is int for side in shape)
    ):
        raise ValueError("an array lacks bytes or shape")
    kind = _number_type(dtype)
    if any(side < 0 for side in shape) or math.prod(shape) * kind.itemsize != len(content):
        raise ValueError(f"the array's size does not fit {len(content)} bytes")
    return np.frombuffer(content, kind).reshape(shape, order="F" if by_columns else "C").astype(np.float64)


def _number_type(dtype: Any) -> np.dtype:
    """Return the type that a pickled dtype names. Raises ValueError for all but types of numbers."""
    if not isinstance(dtype, _Dtype) or not dtype.arguments or not isinstance(dtype.arguments[0], str):
        raise ValueError("an array lacks a type")
    code = dtype.arguments[0]
    if code not in ("f2", "f4", "f8", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8"):
        raise ValueError(f"expected an array of numbers, got type {code[:20]!r}")
    order = dtype.state[1] if len(dtype.state) > 1 else "<"
    return np.dtype(code).newbyteorder(">" if order == ">" else "<")
