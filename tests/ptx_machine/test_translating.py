"""Reading PTX: scopes, labels, tables of branches, spaces; what is not known is refused with its line."""

from __future__ import annotations

import ctypes
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from mgsr.native.cuda import compiler
from mgsr.native.cuda.params import Int, Pointer, pointer
from tests.optional import present
from tests.ptx_machine.launcher import PtxLauncher, pointers_in
from tests.ptx_machine.nvrtc import ARCH, missing_tools, options
from tests.ptx_machine.one_instruction import Case, execute, module_text
from tests.ptx_machine.ptx import PtxError
from tests.ptx_machine.test_instructions import units
from tests.ptx_machine.translator import translate

NUMBERS = (0, 1, 2, 3, -5)
CASES = {
    "a block's own register leaves the outer one": Case(
        "setp.lt.s32 %p0, a, 0; { .reg .pred %p0; setp.ne.s32 %p0, a, a; } selp.s32 d, 7, 8, %p0",
        "s32",
        ("s32",),
        lambda a: np.where(a < 0, 7, 8),
        (NUMBERS,),
    ),
    "a table of branches": Case(
        "mov.u32 d, 9; T: .branchtargets L0, L1, L2; setp.gt.u32 %p1, a, 2; @%p1 bra E; brx.idx a, T; "
        "L0: mov.u32 d, 100; bra.uni E; L1: mov.u32 d, 200; bra.uni E; L2: mov.u32 d, 300; E: not.b32 d, d",
        "u32",
        ("u32",),
        lambda a: ~np.array([100, 200, 300, 9, 9], np.uint32),
        ((0, 1, 2, 3, 4),),
    ),
    "a comment and a statement of two lines": Case(
        "add.s32 // the sum\n d, a, /* of\n both */\n a", "s32", ("s32",), lambda a: 2 * a, (NUMBERS,)
    ),
    "shared memory by a generic address": Case(
        ".shared .align 4 .b8 S[64]; mov.u64 %rd5, S; cvta.shared.u64 %rd6, %rd5; mul.wide.u32 %rd7, %r10, 4; "
        "add.s64 %rd6, %rd6, %rd7; st.s32 [%rd6], a; add.s64 %rd5, %rd5, %rd7; ld.shared.s32 d, [%rd5+0]",
        "s32",
        ("s32",),
        lambda a: a,
        (NUMBERS,),
    ),
    "local memory by a generic address": Case(
        ".local .align 8 .b8 D[16]; .reg .b64 %SP; .reg .b64 %SPL; mov.u64 %SPL, D; cvta.local.u64 %SP, %SPL; "
        "st.s32 [%SP+8], a; ld.local.s32 d, [%SPL+8]",
        "s32",
        ("s32",),
        lambda a: a,
        (NUMBERS,),
    ),
    "a narrow load repeats the sign": Case(
        ".local .align 8 .b8 D[16]; mov.u64 %rd5, D; st.local.u32 [%rd5], a; ld.local.s8 d, [%rd5]",
        "s32",
        ("s32",),
        lambda a: a.astype(np.int8).astype(np.int32),
        ((127, 128, 255, 256, 1000),),
    ),
}


@pytest.fixture
def tools() -> None:
    if reason := missing_tools():
        pytest.skip(reason)


@pytest.mark.parametrize("number", range(len(CASES)), ids=list(CASES))
def test_reads(number: int, tools: None) -> None:
    case = list(CASES.values())[number]
    np.testing.assert_array_equal(execute(tuple(CASES.values()), number), case.witness(*case.arguments()))


@pytest.mark.parametrize(
    ("statement", "message"),
    [
        ("atom.global.add.u32 d, [%rd1], a", "the instruction atom is not known"),
        ("call.uni (d), f, (a)", "the instruction call is not known"),
        ("cvt.rn.f16.f32 d, a", "this conversion is not known"),
        ("add.rn.bf16 d, a, a", "not known"),
        ("fma.rn.relu.f32 d, a, a, a", "fma of floats is not known with {'relu'}"),
        ("add.cc.u32 d, a, a", "add.cc of integers is not known"),
        ("bar.sync 1, 64", "of barriers, those of the whole block"),
        ("ld.acquire.gpu.global.u32 d, [%rd1]", ".acquire is not known"),
        ("mov.u32 d, %clock", "`%clock` is not known"),
        ("mov.u32 d, nowhere", "`nowhere` is not known"),
        ("shfl.sync.left.b32 d, a, 1, 31, -1", "this shuffle is not known"),
        ("setp.lt.u32 d", "this form is not known"),
    ],
)
def test_the_unknown_is_refused_with_its_line(statement: str, message: str) -> None:
    text = module_text([Case(statement, "u32", ("u32",), lambda a: a, ((0,),))])
    line = max(i for i, line in enumerate(text.splitlines(), 1) if line.startswith(statement.split(" ")[0]))
    with pytest.raises(PtxError) as refused:
        translate(text)
    assert message in str(refused.value)
    assert f"PTX line {line}, `{statement.split(' ')[0]} " in str(refused.value)


def test_kernels_take_one_struct() -> None:
    with pytest.raises(PtxError, match="expected one struct as parameter"):
        translate(".visible .entry two(.param .u64 two_param_0, .param .u32 two_param_1)\n{\nret;\n}\n")


def test_noise_moves_approximate_results(tools: None) -> None:
    case = Case("ex2.approx.f32 d, a", "f32", ("f32",), np.exp2, (tuple(np.linspace(-9, 3, 99)),))
    exact, noisy = execute((case,), 0), execute((case,), 0, noise_ulps=2)
    assert (units(exact, noisy) == 2).all()
    assert (noisy > exact).any() and (noisy < exact).any()


def test_compiled_as_for_a_gpu(tools: None, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Check that kernels are compiled as for a GPU, with line numbers besides."""
    import cuda.core

    given: list[Any] = []

    class Program:
        def __init__(self, code: str, kind: str, options: Any) -> None:
            given.extend(options.as_bytes("nvrtc"))

    monkeypatch.setattr(cuda.core, "Program", Program)
    monkeypatch.setattr(compiler, "_compile", lambda *arguments: b"cubin")
    compiler.compile_family("adam", ARCH, tmp_path)
    assert {option.decode() for option in given} | {"--generate-line-info"} == set(options(compiler.SOURCES, ARCH))


class Part(ctypes.Structure):
    _fields_ = (("count", Int), ("first", Pointer), ("others", Pointer * 2))


class Whole(ctypes.Structure):
    _fields_ = (("part", Part), ("parts", Part * 2), ("last", Pointer))


def test_pointers_are_found_in_structs_and_arrays() -> None:
    part = Part(7, 1000, (Pointer * 2)(2000, None))
    assert list(pointers_in(Whole(part, (Part * 2)(part, Part()), 3000))) == [1000, 2000, 1000, 2000, 3000]


def test_the_latest_tensor_at_an_address_gives_the_size() -> None:
    launcher, numbers = PtxLauncher(), torch.zeros(10)
    with launcher.noting_tensors():
        pointer(numbers)
        assert launcher._range(numbers.data_ptr()).bytes == 40
        assert launcher._range(present(pointer(numbers[:3]))).bytes == 12
    assert torch.Tensor.data_ptr is torch._C.TensorBase.data_ptr
    with pytest.raises(AssertionError, match="no tensor that was noted"):
        launcher._range(8)
