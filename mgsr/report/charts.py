"""Small line charts as inline SVG.

Colours come from the page's style, so they follow light and dark.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

WIDTH, HEIGHT = 460, 270
LEFT, RIGHT, TOP, BOTTOM = 48, 74, 30, 44


@dataclass(frozen=True)
class Series:
    """A series: its label, its colour class in the style (a or b), and points (x, y) in the order of x."""

    label: str
    color: str
    points: Sequence[tuple[float, float]]


@dataclass(frozen=True)
class Boundary:
    """The beginning of a stage: its place on the x axis and its label."""

    x: float
    label: str


@dataclass(frozen=True)
class Axes:
    """The titles of both axes, and whether y begins at 0."""

    title: str
    x: str
    y: str
    from_zero: bool = False


@dataclass(frozen=True)
class _PlotArea:
    """The rectangle of the data, and its mapping to the picture."""

    low: tuple[float, float]
    high: tuple[float, float]

    def at(self, x: float, y: float) -> tuple[float, float]:
        across = (x - self.low[0]) / (self.high[0] - self.low[0])
        along = (y - self.low[1]) / (self.high[1] - self.low[1])
        return LEFT + across * (WIDTH - LEFT - RIGHT), HEIGHT - BOTTOM - along * (HEIGHT - TOP - BOTTOM)


def line_chart(lines: Sequence[Series], axes: Axes, boundaries: Sequence[Boundary] = ()) -> str:
    """Draw an <svg> element with lines that are labelled at their ends. Returns empty text if no line has a point."""
    lines = [line for line in lines if line.points]
    if not lines:
        return ""
    frame = _frame(lines, axes.from_zero)
    parts = [*_grid(frame, axes), *_stages(frame, boundaries)]
    parts += [_line(line, frame) for line in lines]
    parts += _end_labels(lines, frame)
    words = escape(f"{axes.title}: {_summary(lines)}", quote=True)
    body = "".join(parts)
    return f'<svg class="chart" viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{words}">{body}</svg>'


def ticks(low: float, high: float, about: int) -> list[float]:
    """Return about `about` round numbers (1, 2 or 5 times a power of ten apart) in low..high."""
    step = _round_step((high - low) / max(about, 1))
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [count * step for count in range(first, last + 1)]


def short_number(value: float) -> str:
    """Format a number in short form: 12, 3.5, 12k, 1.2M."""
    for size, letter in ((1e6, "M"), (1e3, "k")):
        if abs(value) >= size:
            return f"{value / size:.3g}{letter}"
    return f"{value:.3g}" if value % 1 else f"{value:.0f}"


def _round_step(rough: float) -> float:
    power = 10.0 ** math.floor(math.log10(rough))
    return next(factor * power for factor in (1, 2, 5, 10) if factor * power >= rough * (1 - 1e-9))


def _frame(lines: Sequence[Series], from_zero: bool) -> _PlotArea:
    xs = [x for line in lines for x, _ in line.points]
    ys = [y for line in lines for _, y in line.points]
    low, high = (0.0 if from_zero else min(ys)), max(ys)
    room = (high - low) or max(abs(high) * 0.1, 1.0)
    bottom = 0.0 if from_zero else low - 0.06 * room
    return _PlotArea((0.0, bottom), (max(*xs, 1e-3), high + 0.08 * room))


def _grid(frame: _PlotArea, axes: Axes) -> list[str]:
    parts = []
    for value in ticks(frame.low[1], frame.high[1], 4):
        _, y = frame.at(0, value)
        parts.append(f'<line class="grid" x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{y:.1f}" y2="{y:.1f}"/>')
        parts.append(f'<text x="{LEFT - 8}" y="{y + 4:.1f}" text-anchor="end">{short_number(value)}</text>')
    base = HEIGHT - BOTTOM
    for value in ticks(frame.low[0], frame.high[0], 5):
        x, _ = frame.at(value, frame.low[1])
        parts.append(f'<text x="{x:.1f}" y="{base + 18}" text-anchor="middle">{short_number(value)}</text>')
    parts.append(f'<line class="axis" x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{base}" y2="{base}"/>')
    middle = (LEFT + WIDTH - RIGHT) / 2
    parts.append(f'<text x="{middle}" y="{HEIGHT - 6}" text-anchor="middle">{escape(axes.x)}</text>')
    parts.append(f'<text class="unit" x="{LEFT - 8}" y="14" text-anchor="end">{escape(axes.y)}</text>')
    return parts


def _stages(frame: _PlotArea, boundaries: Sequence[Boundary]) -> list[str]:
    """Draw a dashed line at the beginning of each stage, with its label if the stage is wide enough for it."""
    parts = []
    places = [*(boundary.x for boundary in boundaries), frame.high[0]]
    for boundary, end in zip(boundaries, places[1:], strict=True):
        x, _ = frame.at(boundary.x, frame.low[1])
        right, _ = frame.at(end, frame.low[1])
        if boundary.x > frame.low[0]:
            parts.append(f'<line class="stage" x1="{x:.1f}" x2="{x:.1f}" y1="{TOP - 10}" y2="{HEIGHT - BOTTOM}"/>')
        if right - x > 6.8 * len(boundary.label) + 6:
            parts.append(f'<text class="stage" x="{x + 4:.1f}" y="{TOP - 6}">{escape(boundary.label)}</text>')
    return parts


def _line(line: Series, frame: _PlotArea) -> str:
    places = [frame.at(x, y) for x, y in line.points]
    path = "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in places)
    x, y = places[-1]
    return (
        f'<path class="line {line.color}" d="{path}"/>'
        f'<circle class="dot {line.color}" cx="{x:.1f}" cy="{y:.1f}" r="3.5"/>'
    )


def _end_labels(lines: Sequence[Series], frame: _PlotArea) -> list[str]:
    """Draw label and last value to the right of each line's end, moved apart if they would overlap."""
    ends = sorted((frame.at(*line.points[-1])[1], index) for index, line in enumerate(lines))
    parts, lowest = [], -math.inf
    for y, index in ends:
        lowest = max(y, lowest + 31)
        line = lines[index]
        x = WIDTH - RIGHT + 8
        value = short_number(line.points[-1][1])
        parts.append(f'<text class="label {line.color}" x="{x}" y="{lowest:.1f}">{escape(line.label)}</text>')
        parts.append(f'<text class="label" x="{x}" y="{lowest + 15:.1f}">{value}</text>')
    return parts


def _summary(lines: Sequence[Series]) -> str:
    ends = (f"{line.label} from {line.points[0][1]:.4g} to {line.points[-1][1]:.4g}" for line in lines)
    return "; ".join(ends)
