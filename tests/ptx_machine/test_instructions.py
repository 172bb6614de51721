"""Each instruction computes what NumPy, Python's integers or exact fractions say that PTX defines."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from fractions import Fraction

import numpy as np
import pytest

from tests.ptx_machine.nvrtc import missing_tools
from tests.ptx_machine.one_instruction import DTYPES, Case, execute
from tests.ptx_machine.rounding import exactly

Witness = Callable[..., np.ndarray]

INTS = (0, 1, 2, 7, 31, 32, 255, 256, 65535, 65536, 2**31 - 1, -1, -2, -7, -32, -255, -65536, -(2**31), -(2**31) + 1)
WORDS = tuple(n % 2**32 for n in INTS)
FEW_WORDS = (0, 1, 0xDEADBEEF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 0x00FF00FF)
LONGS = tuple(n * 2**32 + m for n in (-(2**31), -5, 0, 3, 2**31 - 1) for m in (0, 1, 2**31, 2**32 - 1))
SHORTS = (0, 1, 255, 256, 32767, -1, -255, -32768)
AMOUNTS = (0, 1, 5, 15, 16, 31, 32, 33, 63, 64, 100, 2**31)
INF, NAN = math.inf, math.nan
TINY = 2.0**-140  # a denormal float32
FLOATS = (0.0, -0.0, 1.0, -1.0, 0.1, -2.5, 3.5, 1e-20, 3e20, 16777217.0, TINY, INF, -INF, NAN)
FINITE = (0.1, -2.5, 1 / 3, 1e-3, 12345.678, -7.25, 1.0000001, 0.99999994, 3.0)
POSITIVE = (1.0, 0.1, 2.5, 1e-20, 3e20, 7.0, TINY)
ROUNDED = (
    0.0,
    0.5,
    1.5,
    2.5,
    -0.5,
    -1.5,
    2.4999,
    -7.9,
    255.5,
    300.0,
    3e9,
    5e9,
    -3e9,
    1e19,
    2e19,
    -1e19,
    INF,
    -INF,
    NAN,
)
BOUNDS = {"s32": (-(2**31), 2**31 - 1), "u32": (0, 2**32 - 1), "s64": (-(2**63), 2**63 - 1), "u64": (0, 2**64 - 1)}
BOUNDS |= {"s16": (-(2**15), 2**15 - 1), "u8": (0, 255)}


def whole(function: Callable[..., int], kind: str) -> Witness:
    """Return a function of Python's integers on arrays, wrapped around to the type."""

    def apply(*arrays: np.ndarray) -> np.ndarray:
        bits = 8 * DTYPES[kind].itemsize
        results = [function(*row) % 2**bits for row in zip(*(a.tolist() for a in arrays), strict=True)]
        return np.array(results, f"uint{bits}").view(DTYPES[kind])

    return apply


def single(name: str, kind: str, function: Witness, values: Sequence[float], result: str | None = None) -> Case:
    return Case(f"{name}.{kind} d, a", result or kind, (kind,), function, (values,))


def integer(
    name: str,
    kind: str,
    function: Callable[..., int],
    values: Sequence[int] | None = None,
    result: str | None = None,
    count: int = 2,
) -> Case:
    values = values or {"2": SHORTS, "4": INTS, "8": LONGS}[str(DTYPES[kind].itemsize)]
    if DTYPES[kind].kind == "u":
        values = tuple(v % 2 ** (8 * DTYPES[kind].itemsize) for v in values)
    result = result or kind
    operands = ", ".join("abc"[:count])
    return Case(f"{name}.{kind} d, {operands}", result, (kind,) * count, whole(function, result), (values,) * count)


def divided(a: int, b: int) -> int:
    return -1 if b == 0 else abs(a) // abs(b) * (1 if (a < 0) == (b < 0) else -1)


def remainder(a: int, b: int) -> int:
    return a if b == 0 else a - b * divided(a, b)


def shifted(bits: int, signed: bool, left: bool) -> Callable[[int, int], int]:
    def apply(a: int, by: int) -> int:
        if left:
            return a << by if by < bits else 0
        return a >> min(by, bits if signed else 1000)

    return apply


def shift(name: str, kind: str, left: bool) -> Case:
    bits, signed = 8 * DTYPES[kind].itemsize, kind[0] == "s"
    values = {16: SHORTS, 32: INTS, 64: LONGS}[bits]
    values = values if signed else tuple(v % 2**bits for v in values)
    witness = whole(shifted(bits, signed, left), kind)
    return Case(f"{name}.{kind} d, a, b", kind, (kind, "u32"), witness, (values, AMOUNTS))


def reversed_bits(n: int) -> int:
    return int(f"{n:032b}"[::-1], 2)


def highest(n: int) -> int:
    """Return the place of the highest bit that differs from the sign, or all ones."""
    n = ~n if n < 0 else n
    return n.bit_length() - 1


def permuted(a: int, b: int, selector: int) -> int:
    stored = (b << 32 | a).to_bytes(8, "little")
    nibbles = [selector >> 4 * i & 15 for i in range(4)]
    return int.from_bytes((stored[n & 7] if n < 8 else (255 if stored[n & 7] > 127 else 0) for n in nibbles), "little")


def extracted(a: int, position: int, length: int) -> int:
    field: int = (a % 2**32) >> position & (2**length - 1)
    return field


def extracted_signed(a: int, position: int, length: int) -> int:
    if length == 0:
        return 0
    field = ((a << 300) >> (300 + position)) if position + length <= 32 else a >> min(position, 31)
    if position + length > 32 or length > 32:
        return field
    field &= 2**length - 1
    signed: int = field - 2**length if field >> (length - 1) else field
    return signed


def inserted(a: int, b: int, position: int, length: int) -> int:
    mask = (2**length - 1) << position & (2**32 - 1)
    whole_word: int = b & ~mask | a << position & mask
    return whole_word


INTEGERS = [
    integer("add", "s32", lambda a, b: a + b),
    integer("add", "s64", lambda a, b: a + b),
    integer("add", "u16", lambda a, b: a + b),
    integer("add.sat", "s32", lambda a, b: min(max(a + b, -(2**31)), 2**31 - 1)),
    integer("sub", "u32", lambda a, b: a - b),
    integer("mul.lo", "s32", lambda a, b: a * b),
    integer("mul.lo", "s16", lambda a, b: a * b),
    integer("mul.lo", "u64", lambda a, b: a * b),
    integer("mul.hi", "s32", lambda a, b: a * b >> 32),
    integer("mul.hi", "u32", lambda a, b: a * b >> 32),
    integer("mul.hi", "s64", lambda a, b: a * b >> 64),
    integer("mul.hi", "u64", lambda a, b: a * b >> 64),
    integer("mul.hi", "u16", lambda a, b: a * b >> 16),
    integer("mul.wide", "s32", lambda a, b: a * b, result="s64"),
    integer("mul.wide", "u32", lambda a, b: a * b, result="u64"),
    integer("mul.wide", "u16", lambda a, b: a * b, result="u32"),
    integer("mad.lo", "s32", lambda a, b, c: a * b + c, (0, 3, -7, 2**31 - 1, -(2**31)), count=3),
    integer("mad.hi", "u32", lambda a, b, c: (a * b >> 32) + c, (0, 3, -7, 2**31, -1), count=3),
    Case(
        "mad.wide.s32 d, a, b, c",
        "s64",
        ("s32", "s32", "s64"),
        whole(lambda a, b, c: a * b + c, "s64"),
        (INTS[:12], INTS[:12], (5, -1)),
    ),
    integer("div", "s32", divided),
    integer("div", "u32", divided),
    integer("div", "s64", divided),
    integer("rem", "s32", remainder),
    integer("rem", "u64", remainder),
    integer("min", "s32", min),
    integer("min", "u32", min),
    integer("max", "s64", max),
    integer("max", "s32", lambda a, b, c: max(a, b, c), (0, 3, -7, 2**31 - 1, -(2**31)), count=3),
    integer("abs", "s32", abs, count=1),
    integer("neg", "s32", lambda a: -a, count=1),
    integer("neg", "s16", lambda a: -a, count=1),
    integer("sad", "u32", lambda a, b, c: abs(a - b) + c, (0, 3, -7, 2**31), count=3),
    integer("and", "b32", lambda a, b: a & b),
    integer("or", "b64", lambda a, b: a | b),
    integer("xor", "b16", lambda a, b: a ^ b),
    integer("not", "b32", lambda a: ~a, count=1),
    integer("cnot", "b32", lambda a: a == 0, count=1),
    Case("lop3.b32 d, a, b, c, 0x96", "b32", ("b32",) * 3, lambda a, b, c: a ^ b ^ c, (FEW_WORDS,) * 3),
    Case("lop3.b32 d, a, b, c, 0xCA", "b32", ("b32",) * 3, lambda a, b, c: (a & b) | (~a & c), (FEW_WORDS,) * 3),
    Case("lop3.b32 d, a, b, c, 0x10", "b32", ("b32",) * 3, lambda a, b, c: a & ~b & ~c, (FEW_WORDS,) * 3),
    shift("shl", "b32", True),
    shift("shl", "b64", True),
    shift("shl", "b16", True),
    shift("shr", "u32", False),
    shift("shr", "s32", False),
    shift("shr", "s64", False),
    shift("shr", "u16", False),
    shift("shr", "s16", False),
    Case(
        "shf.l.wrap.b32 d, a, b, c",
        "b32",
        ("b32",) * 3,
        whole(lambda low, high, by: (high << 32 | low) << (by & 31) >> 32, "b32"),
        (FEW_WORDS, FEW_WORDS, AMOUNTS),
    ),
    Case(
        "shf.r.clamp.b32 d, a, b, c",
        "b32",
        ("b32",) * 3,
        whole(lambda low, high, by: (high << 32 | low) >> min(by, 32), "b32"),
        (FEW_WORDS, FEW_WORDS, AMOUNTS),
    ),
    Case(
        "prmt.b32 d, a, b, c",
        "b32",
        ("b32",) * 3,
        whole(permuted, "b32"),
        (FEW_WORDS, (0x8090A0B0, 0x01020304), (0x3210, 0x7654, 0x4040, 0xFEDC, 0x89AB, 0x5)),
    ),
    integer("popc", "b32", int.bit_count, result="u32", count=1),
    integer("popc", "b64", int.bit_count, result="u32", count=1),
    integer("clz", "b32", lambda n: 32 - n.bit_length(), result="u32", count=1),
    integer("clz", "b64", lambda n: 64 - n.bit_length(), result="u32", count=1),
    integer("brev", "b32", reversed_bits, count=1),
    integer("bfind", "u32", highest, result="u32", count=1),
    integer("bfind", "s32", highest, result="u32", count=1),
    integer("bfind", "s64", highest, result="u32", count=1),
    integer("bfind.shiftamt", "u32", lambda n: 31 - highest(n) if n else -1, result="u32", count=1),
    Case(
        "bfe.u32 d, a, b, c",
        "u32",
        ("u32",) * 3,
        whole(extracted, "u32"),
        (FEW_WORDS, (0, 3, 8, 31, 32), (0, 1, 8, 24, 32)),
    ),
    Case(
        "bfe.s32 d, a, b, c",
        "s32",
        ("s32", "u32", "u32"),
        whole(extracted_signed, "s32"),
        (INTS, (0, 3, 8, 31), (0, 1, 8, 24, 32)),
    ),
    Case(
        "bfi.b32 d, a, b, c, 9",
        "b32",
        ("b32", "b32", "u32"),
        whole(lambda a, b, position: inserted(a, b, position, 9), "b32"),
        (FEW_WORDS, FEW_WORDS, (0, 3, 8, 31, 32)),
    ),
    Case(
        "bmsk.clamp.b32 d, a, b",
        "b32",
        ("u32", "u32"),
        whole(lambda position, length: (2 ** min(length, 32) - 1) << min(position, 32), "b32"),
        ((0, 3, 31, 32, 50), (0, 1, 8, 31, 32, 60)),
    ),
]


def flushed(x: np.ndarray) -> np.ndarray:
    return np.where(np.abs(x) < np.finfo(np.float32).tiny, np.copysign(np.float32(0), x), x).astype(np.float32)


def with_ftz(function: Witness) -> Witness:
    return lambda *arrays: flushed(function(*map(flushed, arrays)))


def saturated(x: np.ndarray) -> np.ndarray:
    return np.where(np.isnan(x), np.float32(0), np.clip(x, 0, 1)).astype(x.dtype)


def least(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return minNum: NaN gives way, and -0 is less than +0."""
    lower = np.where((a == b) & np.signbit(b), b, np.where(b < a, b, a))
    return np.where(np.isnan(a), b, np.where(np.isnan(b), a, lower)).astype(a.dtype)


def greatest(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return -least(-a, -b)


def floats(
    name: str, kind: str, function: Witness, values: Sequence[float] = FLOATS, count: int = 2, tolerance: int = 0
) -> Case:
    return Case(
        f"{name}.{kind} d, {', '.join('abc'[:count])}", kind, (kind,) * count, function, (values,) * count, tolerance
    )


def product_and_sum(a: Fraction, b: Fraction, c: Fraction) -> Fraction:
    return a * b + c


ARITHMETIC = [
    floats("add", "f32", np.add),
    floats("add.ftz", "f32", with_ftz(np.add)),
    floats("sub", "f64", np.subtract),
    floats("mul.rn", "f32", np.multiply),
    floats("mul.ftz", "f32", with_ftz(np.multiply)),
    floats("mul.sat", "f32", lambda a, b: saturated(a * b)),
    floats("div.rn", "f32", np.divide),
    floats("div.rn", "f64", np.divide),
    *(
        floats(f"{name}.{direction}", kind, exactly(function, kind, direction), FINITE)
        for direction in ("rz", "rm", "rp")
        for kind in ("f32", "f64")
        for name, function in (("add", Fraction.__add__), ("mul", Fraction.__mul__), ("div", Fraction.__truediv__))
    ),
    *(
        floats(f"fma.{direction}", kind, exactly(product_and_sum, kind, direction), FINITE, count=3)
        for direction in ("rn", "rz", "rm", "rp")
        for kind in ("f32", "f64")
    ),
    floats("mad.rn", "f32", exactly(product_and_sum, "f32"), FINITE, count=3),
    floats("rcp.rn", "f32", lambda a: 1 / a, count=1),
    floats("rcp.rn", "f64", lambda a: 1 / a, count=1),
    floats("sqrt.rn", "f32", np.sqrt, count=1),
    floats("sqrt.rn", "f64", np.sqrt, count=1),
    floats("min", "f32", least),
    floats("max", "f32", greatest),
    floats("min", "f64", least),
    floats("max", "f64", greatest),
    floats("min.NaN", "f32", np.minimum, tuple(v for v in FLOATS if v != 0)),
    floats("max.NaN", "f32", np.maximum, tuple(v for v in FLOATS if v != 0)),
    floats("abs", "f32", np.abs, count=1),
    floats("neg", "f64", np.negative, count=1),
    floats("copysign", "f32", lambda a, b: np.copysign(b, a), tuple(v for v in FLOATS if v == v)),
    floats("ex2.approx", "f32", np.exp2, (-150.0, -127.5, -1.0, 0.0, 0.3, 10.1, 128.0, -INF, NAN), 1, 1),
    floats("ex2.approx.ftz", "f32", with_ftz(np.exp2), (-140.0, -126.5, -1.0, 0.3, 10.1), 1, 1),
    floats("lg2.approx", "f32", np.log2, POSITIVE, 1, 1),
    floats("sin.approx", "f32", np.sin, (0.0, 0.5, -3.0), 1, 1),
    floats("cos.approx", "f32", np.cos, (0.0, 0.5, -3.0), 1, 1),
    floats("tanh.approx", "f32", np.tanh, (0.0, 0.5, -3.0, 40.0), 1, 1),
    floats("rcp.approx.ftz", "f32", with_ftz(lambda a: 1 / a), POSITIVE, 1, 1),
    floats("rcp.approx.ftz", "f64", lambda a: 1 / a, (0.1, 3.0, -7.5), 1, 1),
    floats("rsqrt.approx", "f32", lambda a: (1 / np.sqrt(a.astype(float))).astype(np.float32), POSITIVE, 1, 1),
    floats("sqrt.approx", "f32", np.sqrt, POSITIVE, 1, 1),
    floats("div.full", "f32", np.divide, FINITE, 2, 1),
    floats("div.approx", "f32", lambda a, b: np.where(b == 2e38, 0, a / b), (1.0, 3.0, 0.1, 2e38), 2, 1),
]


def to_whole(round_: Callable[[float], int], kind: str, wide: bool = False) -> Witness:
    """Return a float as an integer, with PTX's values for what doesn't fit."""
    low, high = BOUNDS[kind]

    def convert(value: float) -> int:
        if math.isnan(value):
            bits = 8 * DTYPES[kind].itemsize
            return 2 ** (bits - 1) if wide or bits == 64 else 0
        return low if value == -INF else high if value == INF else min(max(round_(value), low), high)

    return whole(convert, kind)


def fraction_of(x: float) -> Fraction:
    return Fraction(x)


WHOLE: dict[str, Callable[[float], int]] = {"rni": round, "rzi": math.trunc, "rmi": math.floor, "rpi": math.ceil}
CONVERSIONS = [
    *(
        Case(f"cvt.{name}.{kind}.{source} d, a", kind, (source,), to_whole(rule, kind, source == "f64"), (ROUNDED,))
        for name, rule in WHOLE.items()
        for kind in ("s32", "u32", "s64", "u64", "s16")
        for source in ("f32", "f64")
    ),
    *(
        Case(f"cvt.{name}.f32.f32 d, a", "f32", ("f32",), rule, (ROUNDED,))
        for name, rule in (("rni", np.rint), ("rzi", np.trunc), ("rmi", np.floor), ("rpi", np.ceil))
    ),
    Case("cvt.rmi.f64.f64 d, a", "f64", ("f64",), np.floor, (ROUNDED,)),
    Case("cvt.sat.f32.f32 d, a", "f32", ("f32",), saturated, (FLOATS,)),
    Case("cvt.f64.f32 d, a", "f64", ("f32",), lambda a: a.astype(np.float64), (FLOATS,)),
    Case("cvt.rn.f32.f64 d, a", "f32", ("f64",), lambda a: a.astype(np.float32), (FLOATS,)),
    *(
        Case(f"cvt.{way}.f32.{kind} d, a", "f32", (kind,), exactly(fraction_of, "f32", way), (values,))
        for way in ("rn", "rz", "rm", "rp")
        for kind, values in (("f64", FINITE), ("s32", INTS), ("u32", WORDS), ("s64", LONGS))
    ),
    Case("cvt.rn.f64.s64 d, a", "f64", ("s64",), lambda a: a.astype(np.float64), (LONGS,)),
    Case("cvt.s32.s8 d, a", "s32", ("s8",), lambda a: a.astype(np.int32), ((0, 1, 127, -1, -128),)),
    Case("cvt.s64.s32 d, a", "s64", ("s32",), lambda a: a.astype(np.int64), (INTS,)),
    Case("cvt.u64.u32 d, a", "u64", ("u32",), lambda a: a.astype(np.uint64), (WORDS,)),
    Case("cvt.u32.u64 d, a", "u32", ("u64",), whole(lambda a: a, "u32"), (tuple(n % 2**64 for n in LONGS),)),
    Case("cvt.u8.u32 d, a", "u8", ("u32",), whole(lambda a: a, "u8"), (WORDS,)),
    Case("cvt.sat.u8.s32 d, a", "u8", ("s32",), lambda a: np.clip(a, 0, 255).astype(np.uint8), (INTS,)),
    Case("cvt.sat.s16.s64 d, a", "s16", ("s64",), lambda a: np.clip(a, -32768, 32767).astype(np.int16), (LONGS,)),
]


def unordered(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    no_order: np.ndarray = np.isnan(a) | np.isnan(b)
    return no_order


ORDERS = {"eq": np.equal, "lt": np.less, "le": np.less_equal, "gt": np.greater, "ge": np.greater_equal}
COMPARISONS = [
    *(
        Case(f"setp.{name}.{kind} d, a, b", "pred", (kind, kind), rule, (values, values))
        for name, rule in ORDERS.items()
        for kind, values in (("f32", FLOATS), ("f64", FLOATS), ("s32", INTS), ("u32", WORDS), ("s16", SHORTS))
    ),
    *(
        Case(
            f"setp.{name}u.f32 d, a, b",
            "pred",
            ("f32", "f32"),
            lambda a, b, r=rule: r(a, b) | unordered(a, b),
            (FLOATS,) * 2,
        )
        for name, rule in ORDERS.items()
    ),
    Case("setp.ne.f32 d, a, b", "pred", ("f32", "f32"), lambda a, b: (a != b) & ~unordered(a, b), (FLOATS,) * 2),
    Case("setp.neu.f64 d, a, b", "pred", ("f64", "f64"), lambda a, b: a != b, (FLOATS,) * 2),
    Case("setp.num.f32 d, a, b", "pred", ("f32", "f32"), lambda a, b: ~unordered(a, b), (FLOATS,) * 2),
    Case("setp.nan.f32 d, a, b", "pred", ("f32", "f32"), unordered, (FLOATS,) * 2),
    Case("setp.ne.s32 d, a, b", "pred", ("s32", "s32"), np.not_equal, (INTS,) * 2),
    Case("setp.lo.u32 d, a, b", "pred", ("u32", "u32"), np.less, (WORDS,) * 2),
    Case("setp.hs.u64 d, a, b", "pred", ("u64", "u64"), np.greater_equal, (tuple(n % 2**64 for n in LONGS),) * 2),
    *(
        Case(
            f"setp.gt.s32 %p2, c, 0; setp.lt.{name}.s32 d, a, b, {sign}%p2",
            "pred",
            ("s32",) * 3,
            lambda a, b, c, r=rule, s=sign: r(a < b, (c > 0) != (s == "!")),
            (INTS[:6], INTS[:6], (1, -1)),
        )
        for name, rule in (("and", np.logical_and), ("or", np.logical_or), ("xor", np.logical_xor))
        for sign in ("", "!")
    ),
    Case("setp.lt.s32 %p2|d, a, b", "pred", ("s32", "s32"), np.greater_equal, (INTS,) * 2),
    Case("setp.lt.s32 %p2, a, b; not.pred d, %p2", "pred", ("s32", "s32"), np.greater_equal, (INTS,) * 2),
    Case("set.lt.u32.f32 d, a, b", "u32", ("f32", "f32"), lambda a, b: np.where(a < b, 2**32 - 1, 0), (FLOATS,) * 2),
    Case("set.lt.f32.s32 d, a, b", "f32", ("s32", "s32"), lambda a, b: np.where(a < b, 1.0, 0.0), (INTS,) * 2),
    Case(
        "setp.lt.f32 %p2, a, b; selp.f32 d, a, b, %p2",
        "f32",
        ("f32", "f32"),
        lambda a, b: np.where(a < b, a, b),
        (FLOATS,) * 2,
    ),
    Case(
        "slct.f32.s32 d, a, b, c",
        "f32",
        ("f32", "f32", "s32"),
        lambda a, b, c: np.where(c >= 0, a, b),
        (FINITE, FINITE, (0, 1, -1)),
    ),
    Case("mov.b32 d, a", "u32", ("f32",), lambda a: a.view(np.uint32), (FLOATS,)),
    Case("mov.b32 d, 0f3FC00000", "f32", ("f32",), lambda a: np.full_like(a, 1.5), ((0.0,),)),
    Case("mov.f64 d, 0dC004000000000000", "f64", ("f64",), lambda a: np.full_like(a, -2.5), ((0.0,),)),
    Case(
        "mov.b64 d, {a, b}",
        "b64",
        ("u32", "u32"),
        lambda a, b: a.astype(np.uint64) | b.astype(np.uint64) << np.uint64(32),
        (WORDS, WORDS),
    ),
    Case("mov.b64 {_, d}, a", "u32", ("u64",), lambda a: a >> np.uint64(32), (tuple(n % 2**64 for n in LONGS),)),
    Case("setp.lt.s32 %p2, a, 0; mov.s32 d, a; @%p2 neg.s32 d, a", "s32", ("s32",), np.abs, (INTS,)),
    Case("setp.lt.s32 %p2, a, 0; neg.s32 d, a; @!%p2 mov.s32 d, a", "s32", ("s32",), np.abs, (INTS,)),
]
CASES = (*INTEGERS, *ARITHMETIC, *CONVERSIONS, *COMPARISONS)


@pytest.fixture(autouse=True)
def tools() -> None:
    if reason := missing_tools():
        pytest.skip(reason)


def units(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return how many floats lie between two, of the same sign."""
    integer_type = f"int{8 * a.dtype.itemsize}"
    apart: np.ndarray = np.abs(a.view(integer_type) - b.view(integer_type))
    return apart


@pytest.mark.parametrize("number", range(len(CASES)), ids=[case.instruction.replace(" d, a", "") for case in CASES])
def test_computes(number: int) -> None:
    case = CASES[number]
    came = execute(CASES, number)
    with np.errstate(all="ignore"):
        expected = np.asarray(case.witness(*case.arguments())).astype(came.dtype)
    same = came == expected
    if came.dtype.kind == "f":
        same = (same & (np.signbit(came) == np.signbit(expected))) | (np.isnan(came) & np.isnan(expected))
        same |= units(came, expected) <= case.tolerance
    rows = np.stack([np.char.mod("%s", part) for part in (*case.arguments(), came, expected)], axis=1)
    assert same.all(), f"{case.instruction}: operands, result, expected\n{rows[~same][:10]}"
