"""Time against error of the kernels: the rows that `benchmarks/kernels.py` measures, and their evidence section.

In rows of `benchmarks/kernel_choices.py` the variant names what was chosen otherwise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from mgsr.bench.csv_rows import read_csv, write_csv
from mgsr.bench.table import markdown, number

KERNELS = "kernels.csv"
CHOICES = "kernel_choices.csv"
AS_IT_IS = "default"  # the variant of a choice's row in which nothing is changed
# Where an image is off by more than this, a splat crossed a threshold (1/255 of alpha) that it did not in float64.
ROUNDING = 1e-4


@dataclass(frozen=True)
class KernelRow:
    """One kernel in one variant.

    The variant is avx512, avx2 or baseline (the processor's), cuda (a GPU's), or torch (plain float32 torch on the
    processor, for comparison).

    size: what the times are for. forward, backward, least, cpu: milliseconds; medians of each way, the least of both
    together, and the median processor time of all threads. error_max, error_mean: of the output images or values
    against float64. gradient_max, gradient_mean: of the gradients, relative to the largest and to the mean true
    gradient of the same input; the worst input counts. None where there is none. witness: what float64 the errors are
    against, on what.
    """

    kernel: str
    variant: str
    size: str
    forward: float
    backward: float | None
    least: float
    cpu: float
    error_max: float
    error_mean: float
    gradient_max: float | None
    gradient_mean: float | None
    witness: str
    commit: str
    machine: str
    note: str = ""

    @property
    def cost(self) -> float:
        """Return the milliseconds of forward and backward.

        They are those of the GPU, or what all threads of the processor spent together, which other programs change
        least.
        """
        return self.forward + (self.backward or 0.0) if self.variant == "cuda" else self.cpu


def write_kernels(path: Path, rows: Sequence[KernelRow]) -> None:
    """Write the rows, with four digits of each figure."""
    write_csv(path, KernelRow, rows, digits=4)


def read_kernels(path: Path) -> list[KernelRow]:
    """Read what `write_kernels` wrote; no rows where there is no file."""
    return read_csv(path, KernelRow)


def kernel_section(rows: Sequence[KernelRow], choices: Sequence[KernelRow] = ()) -> str:
    """Return the table, the plot, and what they come to; empty without rows.

    choices: rows whose variant is what was chosen otherwise.
    """
    if not rows:
        return ""
    return "\n\n".join(
        (
            "## The kernels: time against error",
            "Every kernel computes in float32. Errors are differences to float64: outputs in their own units, "
            "gradients relative to the largest and to the mean true gradient of the same input. Times are "
            "milliseconds with all threads, and CPU is the sum over all threads. `torch` is plain float32 torch; it "
            f"shows the error of float32 itself. {_machines(rows)}.",
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
        "Tile sizes and the exponential are fixed when the kernels are built. Each row changes one of them. "
        f"Brackets give the value of the default kernels, or the difference to it ({_machines(rows)}):",
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
    sentences = [
        _against(rows, best, other, words) for other, words in (("baseline", "The baseline"), ("torch", "Plain torch"))
    ]
    crossed = list(dict.fromkeys(row.kernel for row in rows if row.error_max > ROUNDING))
    if crossed:
        sentences.append(
            f"Errors above {ROUNDING:.0e} do not come from rounding. A splat falls on the other side of a threshold, "
            f"or a depth lies where hardly anything is visible: {', '.join(crossed)}."
        )
    worst = max((row for row in rows if row.gradient_max is not None), key=lambda row: row.gradient_max or 0)
    sentences.append(
        f"The worst gradient is that of {worst.kernel}, {worst.variant}: its error is {worst.gradient_max:.1e} of the "
        "largest true gradient."
    )
    lacking = [name for name in ("avx512", "cuda") if name not in variants]
    sentences.append(f"No machine was available to measure {', '.join(lacking)}." if lacking else "")
    return " ".join(words for words in sentences if words)


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
