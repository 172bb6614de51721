"""The page: well-formed, alone, escaped, small; with whatever a run lacks left out."""

from __future__ import annotations

import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np

from mgsr.report.html import report_page, write_report_html
from mgsr.report.pictures import Picture, ReportPictures, SurfacePictures, TestViewPictures
from tests.report.samples import bare_report, sample_pictures, sample_report

VOID = {"meta", "link", "img", "input", "br"}
STRANGE = "a<b>&\"quote'</title><script>alert(1)</script>é"


class Reader(HTMLParser):
    """A parser that checks that tags close in order, and keeps images and tags."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[str] = []
        self.attributes: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open and self.open[-1] == tag, f"</{tag}> closes {self.open[-3:]}"
        self.open.pop()

    def handle_data(self, data: str) -> None:
        self.text += data


def read(page: str) -> Reader:
    reader = Reader()
    reader.feed(page)
    reader.close()
    assert reader.open == []
    return reader


def surface() -> SurfacePictures:
    sides = [Picture(name, np.full((8, 8, 4), 90, np.uint8)) for name in ("front", "right", "back", "left")]
    return SurfacePictures(sides, sides, sides)


def full_page() -> str:
    return report_page(sample_report(), replace(sample_pictures(), surface=surface(), relit=surface().shaded))


def test_tags_close_and_ids_are_unique() -> None:
    ids = [attributes["id"] for _, attributes in read(full_page()).attributes if "id" in attributes]
    assert len(ids) == len(set(ids))


def test_the_page_asks_for_nothing_outside_itself() -> None:
    page = full_page()
    assert not re.search(r"https?:|//[a-z]|@import|url\((?!#)", re.sub(r"base64,[^\"]*", "", page))
    for tag, attributes in read(page).attributes:
        for name in ("src", "href"):
            assert name not in attributes or str(attributes[name]).startswith("data:"), (tag, name)


def test_every_picture_has_words_and_a_size() -> None:
    images = [attributes for tag, attributes in read(full_page()).attributes if tag == "img"]
    assert images and all(image["alt"] and image["width"] and image["height"] for image in images)
    charts = [attributes for tag, attributes in read(full_page()).attributes if attributes.get("role") == "img"]
    assert len(charts) == 2 and all(chart["aria-label"] for chart in charts)


def test_the_page_shows_the_runs_own_curve_of_error_against_time() -> None:
    data = sample_report()
    paths = [dict(attrs) for tag, attrs in read(full_page()).attributes if tag == "path"]
    drawn = {(each["class"] or "").split()[-1]: (each["d"] or "").count("L") + 1 for each in paths[:2]}
    assert drawn == {
        "a": sum(row.psnr_surfels is not None for row in data.curve),
        "b": sum(row.psnr_gaussians is not None for row in data.curve),
    }
    assert "seconds of training" in full_page() and "PSNR on test views, dB: 2D from" in full_page()


def test_strange_names_are_shown_as_they_are() -> None:
    data = sample_report(STRANGE, f"mgsr-worker run '{STRANGE}'")
    page = report_page(data, sample_pictures(STRANGE))
    reader = read(page)
    assert page.count("<script>") == 1 and "alert(1)</script>" not in page
    assert STRANGE in reader.text
    assert any(STRANGE in str(attributes.get("alt")) for _, attributes in reader.attributes)


def test_a_run_without_split_truth_views_or_mesh_still_has_a_page(tmp_path: Path) -> None:
    data = replace(bare_report(), gt=None, mesh=None, curve=[], psnr_test=None, ssim_test=None)
    write_report_html(tmp_path / "report.html", data, ReportPictures())
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    read(page)
    assert "The light split" not in page and "<h2>Training</h2>" not in page and "<svg" not in page


def test_a_view_of_one_branch_shows_what_there_is() -> None:
    picture = np.zeros((8, 12, 3), np.uint8)
    page = report_page(sample_report(), ReportPictures([TestViewPictures("view", picture, picture, normal=picture)]))
    assert sum(tag == "img" for tag in read(page).tags) == 3


def test_a_view_under_a_flash_shows_even_light_in_two_rows() -> None:
    picture = np.zeros((8, 12, 3), np.uint8)
    of_all = (picture, picture, picture, picture, picture, picture, picture)
    view = TestViewPictures("view", *of_all, unlit=picture)
    page = report_page(sample_report(), ReportPictures([view]))
    assert "even light, no flash" in page and 'class="row four hero"' in page
    assert "even light" not in report_page(sample_report(), ReportPictures([replace(view, unlit=None)]))


def test_the_model_in_new_light_has_a_row_where_there_is_one() -> None:
    lights = [Picture(f"{angle}°", np.zeros((8, 8, 4), np.uint8)) for angle in range(0, 360, 60)]
    page = read(report_page(sample_report(), replace(sample_pictures(), relit=lights)))
    shown = [attributes["alt"] for tag, attributes in page.attributes if tag == "img"]
    assert [f"Textured model, {angle}°" in shown for angle in range(0, 360, 60)] == [True] * 6
    assert (
        "In new light" in page.text and "In new light" not in read(report_page(sample_report(), ReportPictures())).text
    )


def test_eight_test_views_and_the_surface_stay_under_four_megabytes() -> None:
    """Check that eight test views and the surface stay under four megabytes.

    Half of the pictures' pixels are noise: ten times the bytes of a rendered object.
    """
    noise = sample_pictures(views=8, size=256).views[0].photo.copy()
    noise[:, ::2] = 128
    views = [TestViewPictures(str(i), noise, noise, noise, noise[..., :3], noise, noise, noise) for i in range(8)]
    noise[:64] = noise[-64:] = 0
    assert len(report_page(sample_report(), ReportPictures(views, (), surface()))) < 4 * 2**20


def test_values_that_are_not_finite_are_left_out() -> None:
    data = replace(sample_report(), psnr_test=float("nan"))
    assert "nan" not in read(report_page(data, ReportPictures())).text


FINDING = {
    "code": "unseen_side",
    "severity": "warning",
    "text": "no photograph shows a side",
    "amount": 2.5,
    "unit": "sr",
    "cure": "add photographs",
    "photographs": ["r_1"],
    "places": [[0.0, 3.0, 0.0]],
}


def test_the_check_of_the_photographs_is_told_and_drawn() -> None:
    photographs = [
        {"name": STRANGE if i == 2 else f"r_{i}", "center": [3 * x, 3 * y, 0.1], "direction": [-x, -y, 0.0]}
        for i, (x, y) in enumerate([(1, 0), (0, -1), (-1, 0)])
    ]
    data = replace(sample_report(), inspection={"findings": [FINDING], "photographs": photographs})
    reader = read(report_page(data, sample_pictures()))
    assert "No photograph shows a side (r_1). What to do: add photographs." in reader.text and "2.5 sr" in reader.text
    marks = [attributes["class"] for tag, attributes in reader.attributes if tag in ("circle", "path")]
    ours = [mark for mark in marks if mark and mark.startswith(("camera", "missing"))]
    assert ours == ["camera", "camera bad", "camera", "missing"] and reader.tags.count("script") == 1


def test_a_report_without_a_check_says_nothing_of_it() -> None:
    assert "checked" not in report_page(sample_report(), sample_pictures())
