"""Kernels of a single PTX instruction, for comparing what it computes with an independent witness."""

from __future__ import annotations

import ctypes
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import torch

from mgsr.native.cuda.params import Pointer, pointer
from tests.ptx_machine.launcher import PtxLauncher
from tests.ptx_machine.library import Library, load_ptx

DTYPES: dict[str, Any] = {
    **{
        f"{kind}{bits}": np.dtype(f"{name}{bits}")
        for kind, name in (("s", "int"), ("u", "uint"))
        for bits in (8, 16, 32, 64)
    },
    **{f"b{bits}": np.dtype(f"uint{bits}") for bits in (8, 16, 32, 64)},
    "f32": np.dtype("float32"),
    "f64": np.dtype("float64"),
}
REGISTERS = {"pred": "p", 1: "rs", 2: "rs", 4: "r", 8: "rd"}
MOST = 1024  # values: a thread each, of one block


@dataclass(frozen=True)
class Case:
    """An instruction on operands d, a, b, c, the types of these, and what it gives by the witness on NumPy arrays.

    values: what each operand takes, in all combinations. A result of type pred comes as 0 or 1. tolerance: in units in
    the last place, of instructions that are approximate."""

    instruction: str
    result: str
    sources: tuple[str, ...]
    witness: Callable[..., Any]
    values: tuple[Sequence[Any], ...]
    tolerance: int = 0

    def arguments(self) -> list[np.ndarray]:
        grids = np.meshgrid(*(np.arange(len(v)) for v in self.values), indexing="ij")
        return [
            np.array(list(v), dtype=DTYPES[kind])[grid.ravel()]
            for v, kind, grid in zip(self.values, self.sources, grids, strict=True)
        ]


class Params(ctypes.Structure):
    _fields_ = (("d", Pointer), ("a", Pointer), ("b", Pointer), ("c", Pointer))


def kernel_text(name: str, case: Case) -> str:
    """Return PTX of a kernel whose thread i loads the operands i, executes the instruction, and stores d."""
    lines, names = [], {"d": _register(case.result, 0)}
    for number, (letter, kind) in enumerate(zip("abc", case.sources, strict=False), 1):
        names[letter] = _register(kind, number)
        lines += _place(name, 8 * number, number, kind)
        lines.append(f"ld.global.{kind} {names[letter]}, [%rd2{number}];")
    lines.append(re.sub(r"\b([abcd])\b", lambda m: names.get(m[1], m[1]), case.instruction) + ";")
    result, kind = names["d"], case.result
    if kind == "pred":
        lines.append("selp.u32 %r9, 1, 0, %p0;")
        result, kind = "%r9", "u32"
    lines += [*_place(name, 0, 0, kind), f"st.global.{kind} [%rd20], {result};", "ret;"]
    registers = [".reg .pred %p<4>;", ".reg .b16 %rs<4>;", ".reg .b32 %r<16>;", ".reg .b64 %rd<32>;"]
    registers += [".reg .f32 %f<4>;", ".reg .f64 %fd<4>;"]
    body = "\n".join([*registers, "mov.u32 %r10, %tid.x;", *lines])
    return f".visible .entry {name}(.param .align 8 .b8 {name}_param[32])\n{{\n{body}\n}}\n"


def _register(kind: str, number: int) -> str:
    if kind in ("f32", "f64"):
        return f"%{'f' if kind == 'f32' else 'fd'}{number}"
    return f"%{REGISTERS[kind if kind == 'pred' else DTYPES[kind].itemsize]}{number}"


def _place(name: str, field: int, number: int, kind: str) -> list[str]:
    """Return the address of the thread's element in the array of a field, in %rd2<number>."""
    return [
        f"ld.param.u64 %rd1{number}, [{name}_param+{field}];",
        f"mul.wide.u32 %rd2{number}, %r10, {DTYPES[kind].itemsize};",
        f"add.s64 %rd2{number}, %rd1{number}, %rd2{number};",
    ]


def module_text(cases: Sequence[Case]) -> str:
    """Return PTX of a kernel for each case: case_0, case_1, ..."""
    head = ".version 9.0\n.target sm_90\n.address_size 64\n"
    return head + "".join(kernel_text(f"case_{i}", case) for i, case in enumerate(cases))


@cache
def library(cases: tuple[Case, ...]) -> Library:
    return load_ptx(module_text(cases), "instructions")


def execute(cases: tuple[Case, ...], number: int, noise_ulps: int = 0) -> np.ndarray:
    """Return what the machine makes of a case's values."""
    case = cases[number]
    arguments = [torch.from_numpy(values.view(_signed(values.dtype))) for values in case.arguments()]
    count = len(arguments[0])
    assert count <= MOST, f"{case.instruction}: {count} combinations"
    dtype = DTYPES["u32" if case.result == "pred" else case.result]
    result = np.zeros(count, dtype)
    launcher = PtxLauncher(noise_ulps=noise_ulps)
    with launcher.noting_tensors():
        pointers = [pointer(torch.from_numpy(result.view(_signed(dtype)))), *map(pointer, arguments)]
        launcher.run(library(cases), f"case_{number}", 1, count, Params(*pointers))
    return result


def _signed(dtype: Any) -> Any:
    """Return the type of the same width that torch has on every version."""
    return np.dtype(f"int{8 * dtype.itemsize}") if dtype.kind == "u" else dtype
