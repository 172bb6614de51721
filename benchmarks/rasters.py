"""What the rasterizers' benchmarks share: the kernel scenes, the timing of alternating modes, and the table."""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from mgsr.data.camera import Camera

NAMES = ("means", "quats", "scales", "opacities", "rgb")
HEADER = ("scene", "variant", "mode", "forward ms", "backward ms", "both: median (least)", "CPU ms")


class RasterScene:
    """One file of the raster folder. splats: fresh leaves of its Gaussians, in the order of NAMES; gradient [H,W,3]
    and grey_gradient [H,W]: what to send into backward; reference: its float64 image [H,W,3] where there is one."""

    def __init__(self, folder: Path, name: str) -> None:
        data = np.load(folder / f"{name}.npz")
        self.splats = [torch.tensor(data[key]).requires_grad_() for key in NAMES]
        size = int(data["width"]), int(data["height"])
        self.camera = Camera(data["K"].astype(float), data["viewmat"].astype(float), *size)
        self.background = torch.tensor(data["background"])
        self.gradient = torch.tensor(data["grad_image"])
        self.grey_gradient = self.gradient[..., 0].contiguous()
        reference = folder / f"ref_{name}.npz"
        self.reference = np.load(reference)["img"] if reference.exists() else None

    def gradient_of(self, image: Tensor) -> Tensor:
        """The gradient to send into an output image of three channels or of one."""
        return self.gradient if image.ndim == 3 else self.grey_gradient


class Times(NamedTuple):
    """One run, milliseconds: wall time of forward and of backward, and processor time of all threads over both."""

    forward: float
    backward: float
    cpu: float


def measure(modes: dict[str, Callable[[], list[Tensor]]], scene: RasterScene, runs: int) -> dict[str, list[Times]]:
    """The times of each mode, which renders the images to differentiate. Modes alternate, after two runs uncounted."""
    times: dict[str, list[Times]] = {mode: [] for mode in modes}
    for run in range(runs + 2):
        for mode, render in modes.items():
            begin, begin_cpu = time.perf_counter(), time.process_time()
            images = render()
            middle = time.perf_counter()
            torch.autograd.backward(images, [scene.gradient_of(image) for image in images])
            end, end_cpu = time.perf_counter(), time.process_time()
            if run >= 2:
                times[mode].append(Times((middle - begin) * 1e3, (end - middle) * 1e3, (end_cpu - begin_cpu) * 1e3))
    return times


def cells(rows: list[Times]) -> list[str]:
    """The table's cells of one mode, from `forward ms` on: medians, and the least of both."""
    forward, backward, cpu = (f"{statistics.median(column):.2f}" for column in zip(*rows, strict=True))
    both = [row.forward + row.backward for row in rows]
    return [forward, backward, f"{statistics.median(both):.2f} ({min(both):.2f})", cpu]


def print_row(row: Iterable[str]) -> None:
    """One line of a Markdown table, at once."""
    print(f"| {' | '.join(row)} |", flush=True)


def arguments(description: str | None, isas: list[str]) -> argparse.Namespace:
    """folder, scenes, runs, isa, threads."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("scenes", nargs="+")
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--isa", nargs="*", default=isas, help="variants to measure; all by default")
    parser.add_argument("--threads", type=int, default=0, help="0: all processors")
    return parser.parse_args()
