"""Read arrays from untrusted or damaged .npz files."""

from __future__ import annotations

import textwrap
import tokenize
import zipfile
import zlib
from pathlib import Path

import numpy as np

# The errors that numpy and zipfile raise for damaged arrays and archives.
DAMAGE = (
    ArithmeticError,
    EOFError,
    LookupError,
    MemoryError,
    OSError,
    RuntimeError,  # as well of compressions that zipfile does not know
    SyntaxError,  # of an array's header
    TypeError,
    ValueError,
    tokenize.TokenError,  # of a header, too
    zipfile.BadZipFile,
    zlib.error,
)


def read_arrays(path: Path, largest: int = 1 << 31) -> dict[str, np.ndarray]:
    """Read the file's numeric arrays [...] by name.

    Raises ValueError for damaged files, for arrays that are not numeric, and for arrays larger than `largest` bytes, as
    in a file made to fill the memory.
    """
    try:
        with zipfile.ZipFile(path) as members:
            for member in members.infolist():
                if member.file_size > largest:
                    raise ValueError(f"{member.filename} has {member.file_size} bytes, expected at most {largest}")
        with np.load(path, allow_pickle=False) as content:
            arrays = {name: np.asarray(content[name]) for name in content.files}
    except DAMAGE as error:
        raise ValueError(textwrap.shorten(str(error), 100) or type(error).__name__) from error
    for name, array in arrays.items():
        if array.dtype.kind not in "biuf":
            raise ValueError(f"{name} has type {array.dtype}, expected numbers")
    return arrays
