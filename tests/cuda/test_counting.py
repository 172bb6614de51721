"""Tests of what benchmarks/sass.py and benchmarks/walks.py count, on kernels and lists that can be counted by hand."""

from __future__ import annotations

import numpy as np

from benchmarks.sass import loops_of
from benchmarks.walks import Lists, Splats, View, count_gsplat, count_ours

KERNEL = """
.text.nested:
        /*0000*/                   MOV R0, RZ ;
.L_x_0:
        /*0010*/                   IADD3 R0, R0, 0x1, RZ ;
.L_x_1:
        /*0020*/                   MUFU.EX2 R1, R1 ;
        /*0030*/               @P1 BRA `(.L_x_2) ;
        /*0040*/                   DADD R2, R2, R4 ;
        /*0050*/                   FADD R3, R3, R4 ;
.L_x_2:
        /*0060*/               @P0 BRA `(.L_x_1) ;
        /*0070*/               @P3 BRA `(.L_x_3) ;
        /*0080*/                   CALL.REL.NOINC `(.L_x_9) ;
.L_x_3:
        /*0090*/               @P2 BRA `(.L_x_0) ;
        /*00a0*/                   EXIT ;
.L_x_9:
        /*00b0*/                   RET.REL.NODEC R6 `(nested);
        /*00c0*/                   NOP;
"""


def test_loops_and_their_instructions() -> None:
    kernel = loops_of(KERNEL)
    (outer,) = kernel.inner
    (step,) = outer.inner
    assert (kernel.always, kernel.sometimes) == (2, 0)
    assert (outer.always, outer.sometimes) == (3, 0)  # the call, of a slow way, is left out
    assert (step.always, step.sometimes, step.exponentials) == (3, 2, 1)
    assert (step.always_doubles, step.sometimes_doubles) == (0, 1)
    assert step.at(0.5) == 4


def one_tile(opacity: float, count: int) -> View:
    """Return a view of `count` equal splats in the middle of the second patch (8 to 15, 0 to 3) of a single tile."""
    opacities = np.tile(np.array([opacity, 0], np.float32), (count, 1))
    roots = np.tile(np.array([2, 0, 2], np.float32), (count, 1))
    splats = Splats(np.tile([12.0, 2.0], (count, 1)), roots, opacities)
    return View(splats, Lists(np.arange(count), np.array([0, count]), 16, 16), np.arange(count))


def test_walks_of_faint_splats() -> None:
    """Check the walks of forty splats, none of which closes a pixel.

    Ours walks them in one patch of eight, gsplat's eight warps all of them.
    """
    view = one_tile(0.05, 40)
    ours = count_ours(view, dual=False)
    expected = {"batches": 8, "buckets": 16, "steps": 40, "useful": 40, "back_buckets": 2}
    assert {name: ours[name] for name in expected} == expected
    assert ours["back_patches"] == 2 and ours["back_chunks"] == 4 + 1
    theirs = count_gsplat(view, 0)
    assert theirs["steps"] == 8 * 40 and theirs["useful"] == theirs["back_useful"] == 2 * 40
    assert theirs["back_steps"] == 2 * 40  # of the warps in which a splat counts


def test_walks_end_where_pixels_are_closed() -> None:
    """Check that walks over splats that cover the whole tile end at the second, which closes every pixel."""
    view = one_tile(0.999, 3)
    view.splats.roots[:] = np.float32(1e-4)
    assert count_ours(view, dual=False)["steps"] == 8 * 3  # a bucket that is begun is walked
    theirs = count_gsplat(view, 0)
    assert theirs["steps"] == 8 * 2 and theirs["back_steps"] == 8
