"""Time and error of the kernels, as `benchmarks/kernels.py` measures them: a row for each kernel and variant.

In `benchmarks/kernel_choices.py` the variant is what was chosen otherwise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from mgsr.bench.csv_rows import read_csv, write_csv

KERNELS = "kernels.csv"
CHOICES = "kernel_choices.csv"
AS_IT_IS = "as it is"  # the variant of a choice's row in which nothing is changed


@dataclass(frozen=True)
class KernelRow:
    """One kernel in one variant.

    The variant is avx512, avx2 or baseline (the processor's), cuda (a card's), or torch (plain float32 torch on the
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

        They are those of the card, or what all threads of the processor spent together, which other programs change
        least.
        """
        return self.forward + (self.backward or 0.0) if self.variant == "cuda" else self.cpu


def write_kernels(path: Path, rows: Sequence[KernelRow]) -> None:
    """Write the rows, with four digits of each figure."""
    write_csv(path, KernelRow, rows, digits=4)


def read_kernels(path: Path) -> list[KernelRow]:
    """Read what `write_kernels` wrote; no rows where there is no file."""
    return read_csv(path, KernelRow)
