"""The part of the evidence page on the kernels: time against error to float64."""

from __future__ import annotations

from collections.abc import Sequence

from mgsr.bench.kernel_results import AS_IT_IS, KernelRow
from mgsr.bench.table import markdown, number

# Where an image is off by more than this, a splat crossed a threshold (1/255 of alpha) that it did not in float64.
ROUNDING = 1e-4


def kernel_section(rows: Sequence[KernelRow], choices: Sequence[KernelRow] = ()) -> str:
    """Return the table, the plot, and what they come to; empty without rows.

    choices: rows whose variant is what was chosen otherwise.
    """
    if not rows:
        return ""
    return "\n\n".join(
        (
            "## The kernels: time against error",
            "Every kernel computes in float32; the errors are those against float64 (outputs in their own units, "
            "gradients relative to the largest and to the mean true gradient of the same input). Times are "
            "milliseconds with all threads; CPU is what all threads spent together; `torch` is plain float32 torch, "
            f"which shows how large float32's own error is. {_machines(rows)}.",
            "![Milliseconds against the largest error of each kernel and variant](images/evidence/kernels.svg)",
            kernel_table(rows),
            _words(rows),
            *_choices(choices),
        )
    )


def _machines(rows: Sequence[KernelRow]) -> str:
    return "; ".join(dict.fromkeys(f"{row.machine}, {row.commit}{': ' + row.note if row.note else ''}" for row in rows))


def _choices(rows: Sequence[KernelRow]) -> list[str]:
    """Return the table of the rasterizers with one choice made otherwise, each beside the sources as they are."""
    usual = {row.kernel: row for row in rows if row.variant == AS_IT_IS}
    others = [row for row in rows if row.variant != AS_IT_IS and row.kernel in usual]
    if not others:
        return []
    head = ["kernel", "choice", "CPU, ms", "largest error", "gradient: largest"]
    cells = [
        [
            row.kernel,
            row.variant,
            f"{row.cpu:.2f} ({row.cpu / usual[row.kernel].cpu - 1:+.0%})",
            _beside(row.error_max, usual[row.kernel].error_max),
            _beside(row.gradient_max, usual[row.kernel].gradient_max),
        ]
        for row in others
    ]
    return [
        "Tile sizes and the exponential are fixed when the kernels are built. Built with one of them chosen otherwise, "
        f"and in brackets what the kernels as they are have, or how far from that it is ({_machines(rows)}):",
        markdown(head, cells),
    ]


def _beside(own: float | None, usual: float | None) -> str:
    return f"{number(own, '.1e')} ({number(usual, '.1e')})"


def kernel_table(rows: Sequence[KernelRow]) -> str:
    """Return the table of all rows."""
    head = ["kernel", "variant", "timed on", "forward", "backward", "both, least", "CPU", "largest error", "mean error"]
    head += ["gradient: largest", "mean", "against"]
    return markdown(head, [_cells(row) for row in rows])


def _cells(row: KernelRow) -> list[str]:
    times = [number(value, ".2f") for value in (row.forward, row.backward, row.least, row.cpu)]
    errors = [number(x, ".1e") for x in (row.error_max, row.error_mean, row.gradient_max, row.gradient_mean)]
    return [row.kernel, row.variant, row.size, *times, *errors, row.witness]


def _words(rows: Sequence[KernelRow]) -> str:
    variants = {row.variant for row in rows}
    best = next((name for name in ("avx512", "avx2") if name in variants), "baseline")
    told = [
        _against(rows, best, other, words) for other, words in (("baseline", "The baseline"), ("torch", "Plain torch"))
    ]
    crossed = list(dict.fromkeys(row.kernel for row in rows if row.error_max > ROUNDING))
    if crossed:
        told.append(
            f"Errors above {ROUNDING:.0e} are no rounding of colours but a splat that falls on the other side of a "
            f"threshold, or a depth where hardly anything is seen: {', '.join(crossed)}."
        )
    worst = max((row for row in rows if row.gradient_max is not None), key=lambda row: row.gradient_max or 0)
    told.append(
        f"The worst gradient: {worst.kernel}, {worst.variant}, {worst.gradient_max:.1e} of the largest true one."
    )
    lacking = [name for name in ("avx512", "cuda") if name not in variants]
    told.append(f"Not measured, for want of such a machine: {', '.join(lacking)}." if lacking else "")
    return " ".join(words for words in told if words)


def _against(rows: Sequence[KernelRow], best: str, other: str, words: str) -> str:
    """Say how much more processor time another variant takes; empty where no kernel has both."""
    known = {(row.kernel, row.variant): row.cpu for row in rows}
    ratios = [
        (known[row.kernel, other] / row.cpu, row.kernel)
        for row in rows
        if row.variant == best != other and (row.kernel, other) in known
    ]
    if not ratios:
        return ""
    (low, least), (high, most) = min(ratios), max(ratios)
    return f"{words} takes {low:.1f} ({least}) to {high:.1f} ({most}) times the processor time of `{best}`."
