"""Plots that are the same for the same results, and that can be read on light and dark pages."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest

from benchmarks.evidence.kernel_plot import write_kernel_plot
from mgsr.bench.plots import COLORS, OTHER, TEXT, write_plots
from mgsr.bench.results import Curve
from tests.bench.samples import sample_rows

PAGES = {"light": "#ffffff", "dark": "#0d1117"}


@pytest.fixture(scope="module", autouse=True)
def matplotlib() -> None:
    pytest.importorskip("matplotlib", reason="PLOTS NEED THE EXTRA bench")


def test_equal_results_give_equal_bytes(tmp_path: Path) -> None:
    rows = sample_rows()
    curves = [Curve(row.key, ((10.0, 25.0), (100.0, 33.0))) for row in rows]
    first, second = (write_plots(tmp_path / name, rows, curves) for name in "ab")
    assert [path.name for path in first] == ["error_seconds.svg", "error_gaussians.svg", "memory.svg"]
    assert [path.read_bytes() for path in first] == [path.read_bytes() for path in second]
    assert sum(path.stat().st_size for path in first) < 200_000


def test_every_scene_and_method_is_named_and_nothing_is_fetched(tmp_path: Path) -> None:
    for path in write_plots(tmp_path, sample_rows(), []):
        ElementTree.parse(path)
        text = path.read_text()
        assert all(word in text for word in ("apple", "pear", "mgsr", "2dgs"))
        assert "<image" not in text and "@import" not in text


def test_the_page_shows_through(tmp_path: Path) -> None:
    path = write_plots(tmp_path, sample_rows(), [])[0]
    colors = set(re.findall(r"(?:fill|stroke): (#[0-9a-f]{6})", path.read_text()))
    assert not colors & {"#ffffff", "#000000"}


@pytest.mark.parametrize("page", list(PAGES))
def test_colours_stand_out_on_either_page(page: str) -> None:
    # WCAG 2.1 asks for 3 : 1 of graphics; no grey has 4.5 : 1 on both pages.
    assert all(contrast(color, PAGES[page]) > 3 for color in (*COLORS.values(), OTHER))
    assert contrast(TEXT, PAGES[page]) > 4


def contrast(a: str, b: str) -> float:
    """Return WCAG 2.1's contrast ratio of two colours."""
    light, dark = sorted((luminance(a), luminance(b)), reverse=True)
    return (light + 0.05) / (dark + 0.05)


def luminance(color: str) -> float:
    parts = [int(color[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    linear = [part / 12.92 if part <= 0.03928 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def test_nothing_to_show_is_no_file(tmp_path: Path) -> None:
    assert write_plots(tmp_path / "plots", [], []) == []
    assert not (tmp_path / "plots").exists()


def test_kernels_are_named(tmp_path: Path) -> None:
    points = [("TV", "avx2", 0.2, 1e-7), ("TV", "baseline", 0.5, 2e-7), ("Adam", "avx2", 1.0, 3e-8)]
    text = write_kernel_plot(tmp_path / "kernels.svg", points).read_text()
    assert all(word in text for word in ("TV", "Adam", "avx2", "baseline"))
