"""The charts: round ticks, points where they belong, labels that do not touch."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from itertools import pairwise

import pytest

from mgsr.report.charts import HEIGHT, WIDTH, Axes, Boundary, Series, line_chart, short_number, ticks

AXES = Axes("Error", "seconds", "dB")


@pytest.mark.parametrize(("low", "high"), [(0, 1), (18.4, 37.2), (0, 294.7), (0, 1_200_000), (-3, 0.001)])
def test_ticks_are_round_and_inside(low: float, high: float) -> None:
    values = ticks(low, high, 4)
    assert 2 <= len(values) <= 6 and values[0] >= low - 1e-6 and values[-1] <= high + 1e-6
    step = values[1] - values[0]
    assert f"{step:.0e}"[0] in "125"


def test_short_numbers() -> None:
    assert [short_number(value) for value in (0, 12, 3.25, 21877, 1_234_567)] == ["0", "12", "3.25", "21.9k", "1.23M"]


def test_points_lie_inside_and_rise_upwards() -> None:
    stages = [Boundary(0, "one"), Boundary(10, "two")]
    chart = line_chart([Series("2D", "a", [(0, 20), (10, 30), (20, 35)])], AXES, stages)
    root = ElementTree.fromstring(chart)
    path = next(each.attrib["d"] for each in root.iter("path"))
    places = [tuple(map(float, pair.split())) for pair in re.split("[ML]", path)[1:]]
    assert all(0 < x < WIDTH and 0 < y < HEIGHT for x, y in places)
    assert places[0][1] > places[1][1] > places[2][1] and places[0][0] < places[1][0] < places[2][0]


def test_labels_of_lines_that_end_together_stand_apart() -> None:
    lines = [Series("2D", "a", [(0, 20), (9, 30)]), Series("3D", "b", [(0, 21), (9, 30)])]
    root = ElementTree.fromstring(line_chart(lines, AXES))
    heights = sorted(float(each.attrib["y"]) for each in root.iter("text") if "label" in each.get("class", ""))
    assert all(after - before >= 14 for before, after in pairwise(heights))
    assert heights[-1] < HEIGHT


@pytest.mark.parametrize("points", [[(0.0, 5.0)], [(0.0, 0.0), (0.0, 0.0)], [(3.0, 7.0), (4.0, 7.0)]])
def test_flat_and_single_points_have_a_chart(points: list[tuple[float, float]]) -> None:
    chart = line_chart([Series("<&>", "a", points)], Axes("<&>", "<", "&", True))
    ElementTree.fromstring(chart)
    assert "nan" not in chart and "inf" not in chart


def test_no_points_no_chart() -> None:
    assert line_chart([Series("2D", "a", [])], AXES) == ""
