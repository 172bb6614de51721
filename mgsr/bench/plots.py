"""Plots of the results as SVG: transparent, with colours that can be read on white and on black alike."""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mgsr.bench.results import DONE, Curve, Row

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

TEXT, GRID = "#767676", "#76767640"
# Each at least 3 : 1 against white and against a page of #0d1117; tests/bench checks this.
COLORS = {"mgsr": "#2f7ed8", "2dgs": "#d9622b", "3dgs": "#1f9a6d"}
OTHER = "#a35bd0"
MARKERS = {"draft": "v", "standard": "o", "high": "^"}
STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",  # text stays text: small files, and the reader's own font
    "svg.hashsalt": "mgsr",  # the same results give the same bytes
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    **{key: TEXT for key in ("text.color", "axes.labelcolor", "axes.edgecolor", "xtick.color", "ytick.color")},
    "grid.color": GRID,
    "axes.grid": True,
    "axes.axisbelow": True,
    "legend.frameon": False,
}
SCORES = (
    ("chamfer", "Chamfer × 1000"),
    ("normal_consistency", "NC × 100"),
    ("psnr", "PSNR, dB"),
)


def have_matplotlib() -> bool:
    """Return whether plots can be drawn here (`pip install 'mgsr[bench]'`)."""
    from importlib.util import find_spec

    return find_spec("matplotlib") is not None


def write_plots(folder: Path, rows: Sequence[Row], curves: Sequence[Curve]) -> list[Path]:
    """Write error_seconds.svg, error_gaussians.svg and memory.svg of the done rows, and return their paths.

    The rows are the plain ones, or the variants where there is no plain one. No file is written without a row.
    """
    done = [row for row in rows if row.state == DONE and row.seconds is not None]
    rows = [row for row in done if not row.variant] or done
    if not rows:
        return []
    with plot_style():
        return [error_over_seconds(folder, rows, curves), error_over_gaussians(folder, rows), memory(folder, rows)]


def error_over_seconds(folder: Path, rows: Sequence[Row], curves: Sequence[Curve]) -> Path:
    """Plot the end points of runs, and the PSNR on the way there, in a column of panels for each scene."""
    scenes = _scenes(rows)
    figure, panels = _panels(len(SCORES), len(scenes), "seconds of the whole run")
    for column, scene in enumerate(scenes):
        for line, (score, label) in enumerate(SCORES):
            panel = panels[line][column]
            if score == "psnr":
                _draw_curves(panel, scene, rows, curves)
            _draw_fronts(panel, [row for row in rows if row.scene == scene], score)
            _finish(panel, score, label if column == 0 else "")
        panels[0][column].set_title(scene, fontsize=9)
    return _save(figure, folder / "error_seconds.svg", rows)


def error_over_gaussians(folder: Path, rows: Sequence[Row]) -> Path:
    """Plot the Gaussians of both branches against each score, in a column of panels for each scene."""
    scenes = _scenes(rows)
    figure, panels = _panels(len(SCORES), len(scenes), "thousand Gaussians")
    for column, scene in enumerate(scenes):
        for line, (score, label) in enumerate(SCORES):
            for row in rows:
                value = getattr(row, score)
                if row.scene == scene and value is not None and row.splats is not None:
                    _dot(panels[line][column], row, row.splats / 1000, value)
            _finish(panels[line][column], score, label if column == 0 else "")
        panels[0][column].set_title(scene, fontsize=9)
    return _save(figure, folder / "error_gaussians.svg", rows)


def memory(folder: Path, rows: Sequence[Row]) -> Path:
    """Plot the most memory that each run held, as bars."""
    known = [row for row in rows if row.memory_mib is not None]
    figure = new_figure(7, 0.8 + 0.22 * len(known))
    panel = figure.subplots()
    names = [f"{row.scene} {row.preset}" + (f" seed {row.seed}" if row.seed else "") for row in known]
    panel.barh(range(len(known)), [row.memory_mib or 0 for row in known], color=[_color(row) for row in known])
    panel.set_yticks(range(len(known)), names)
    panel.invert_yaxis()
    panel.grid(axis="y", visible=False)
    panel.set_xlabel("peak memory, MiB")
    return _save(figure, folder / "memory.svg", known)


def plot_style() -> AbstractContextManager[None]:
    """Apply our style on top of matplotlib's default, whatever the user's style is."""
    from matplotlib import style

    return style.context(["default", STYLE])


def new_figure(width: float, height: float) -> Figure:
    """Create a figure of a size in inches; not by pyplot, which would keep every figure alive."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def write_svg(figure: Figure, path: Path) -> Path:
    """Write a figure as reproducible SVG: its bytes depend only on its contents. Return the path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    path.write_text(_numbered(path.read_text(encoding="utf-8")), encoding="utf-8")
    return path


def _panels(lines: int, columns: int, x_label: str) -> tuple[Figure, list[list[Axes]]]:
    figure = new_figure(2.4 * columns + 0.6, 1.7 * lines + 0.6)
    panels = figure.subplots(lines, columns, squeeze=False, sharex="col")
    for panel in panels[-1]:
        panel.set_xlabel(x_label)
    return figure, panels.tolist()


def _finish(panel: Axes, score: str, label: str) -> None:
    """Label a panel, and scale its axes.

    x begins at zero. Chamfer, which differs by a factor, has a logarithmic scale with plain numbers.
    """
    from matplotlib.ticker import LogLocator, NullFormatter

    panel.set_ylabel(label)
    panel.set_xlim(left=0)
    if score == "chamfer":
        panel.set_yscale("log")
        panel.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        panel.yaxis.set_major_formatter("{x:g}")
        panel.yaxis.set_minor_formatter(NullFormatter())


def _draw_fronts(panel: Axes, rows: Sequence[Row], score: str) -> None:
    """Draw a dot for each run, and join the presets of each method in the order of their time."""
    done = [row for row in rows if getattr(row, score) is not None]
    for method in dict.fromkeys(row.method for row in done):
        own = sorted((row for row in done if row.method == method), key=lambda row: row.seconds or 0)
        if len({row.preset for row in own}) > 1:
            points = [(row.seconds or 0, getattr(row, score)) for row in own if row.seed == own[0].seed]
            panel.plot(*zip(*points, strict=True), color=_color(own[0]), linewidth=1, zorder=2)
        for row in own:
            _dot(panel, row, row.seconds or 0, getattr(row, score))


def _draw_curves(panel: Axes, scene: str, rows: Sequence[Row], curves: Sequence[Curve]) -> None:
    """Draw the curve of each run, shifted by the time before its training."""
    known = {row.key: row for row in rows if row.scene == scene}
    for curve in curves:
        row = known.get(curve.key)
        if row is not None and curve.points:
            shift = row.start_seconds or 0
            xs, ys = [shift + x for x, _ in curve.points], [y for _, y in curve.points]
            panel.plot(xs, ys, color=_color(row), linewidth=0.9, linestyle=":", zorder=1)


def _dot(panel: Axes, row: Row, x: float, y: float) -> None:
    panel.scatter(x, y, color=_color(row), marker=MARKERS.get(row.preset, "s"), s=26, zorder=3)


def _color(row: Row) -> str:
    return COLORS.get(row.method, OTHER)


def _scenes(rows: Sequence[Row]) -> list[str]:
    return list(dict.fromkeys(row.scene for row in rows))


def _save(figure: Figure, path: Path, rows: Sequence[Row]) -> Path:
    """Save a figure with a legend of the methods by colour and the presets by shape."""
    from matplotlib.lines import Line2D

    dot: dict[str, Any] = {"linestyle": "", "markersize": 5}
    methods = dict.fromkeys(row.method for row in rows)
    presets = [preset for preset in MARKERS if preset in {row.preset for row in rows}]
    marks = [Line2D([], [], color=COLORS.get(name, OTHER), marker="s", label=name, **dot) for name in methods]
    marks += [Line2D([], [], color=TEXT, marker=MARKERS[name], label=name, **dot) for name in presets]
    figure.legend(handles=marks, loc="outside upper center", ncols=len(marks))
    return write_svg(figure, path)


def _numbered(svg: str) -> str:
    """Rename the clip paths of an SVG by their order.

    matplotlib names them by their exact positions, and the last digits of these differ between machines.
    """
    names = dict.fromkeys(re.findall(r'<clipPath id="(\w+)"', svg))
    for index, name in enumerate(names):
        svg = svg.replace(name, f"clip{index}")
    return svg
