"""Exact arithmetic with one rounding: the witness for fused and directed operations."""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction

import numpy as np

ROUND: dict[str, Callable[[Fraction], int]] = {"rn": round, "rz": math.trunc, "rm": math.floor, "rp": math.ceil}
FORMATS = {"f32": (24, -149, np.float32), "f64": (53, -1074, np.float64)}


def rounded(exact: Fraction, kind: str, direction: str = "rn") -> float:
    """Return the float of type f32 or f64 that an exact number is rounded to.

    direction: rn nearest and even, rz towards zero, rm down, rp up. Only numbers within the format's range are rounded.
    """
    if exact == 0:
        return 0.0
    digits, least, _ = FORMATS[kind]
    size = abs(exact)
    exponent = size.numerator.bit_length() - size.denominator.bit_length()
    if size < Fraction(2) ** exponent:
        exponent -= 1
    unit = Fraction(2) ** max(exponent - digits + 1, least)
    steps = exact / unit
    return float(ROUND[direction](steps) * unit)


def exactly(operation: Callable[..., Fraction], kind: str, direction: str = "rn") -> Callable[..., np.ndarray]:
    """Return the operation on arrays of finite floats, without an error but the last rounding."""

    def apply(*arrays: np.ndarray) -> np.ndarray:
        rows = zip(*(array.tolist() for array in arrays), strict=True)
        results = [rounded(operation(*map(Fraction, row)), kind, direction) for row in rows]
        return np.array(results, FORMATS[kind][2])

    return apply
