"""The plot of the kernels: time against error, both on logarithmic axes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from mgsr.bench.plots import COLORS, GRID, new_figure, plot_style, write_svg


def write_kernel_plot(path: Path, points: Sequence[tuple[str, str, float, float]]) -> Path:
    """Plot kernels by time and error, and return the path.

    points: (kernel, variant, milliseconds, largest error). A line joins a kernel's variants, and its name stands
    beside.
    """
    with plot_style():
        figure = new_figure(8, 4.5)
        panel = figure.subplots()
        shapes = dict(zip(dict.fromkeys(variant for _, variant, _, _ in points), "os^Dv", strict=False))
        for kernel in dict.fromkeys(name for name, _, _, _ in points):
            own = [point for point in points if point[0] == kernel]
            panel.plot([ms for _, _, ms, _ in own], [error for *_, error in own], color=GRID, zorder=1)
            for _, variant, ms, error in own:
                panel.scatter(ms, error, marker=shapes[variant], color=COLORS["mgsr"], s=22, zorder=2)
            panel.annotate(kernel, (own[-1][2], own[-1][3]), xytext=(5, 3), textcoords="offset points", fontsize=7)
        for variant, shape in shapes.items():
            panel.scatter([], [], marker=shape, color=COLORS["mgsr"], s=22, label=variant)
        panel.set(
            xscale="log",
            yscale="log",
            xlabel="milliseconds of the processor (or GPU), forward and backward",
            ylabel="largest error",
        )
        panel.legend(loc="upper left", bbox_to_anchor=(1, 1))
        return write_svg(figure, path)
