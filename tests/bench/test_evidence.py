"""docs/evidence.md is what the committed results give, and its judgements follow them."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from benchmarks.evidence.comparing import compare, plain_runs, seed_spread, verdict
from benchmarks.evidence.exposures import (
    EVEN,
    EVENED,
    KEPT,
    ExposureRow,
    exposure_section,
)
from benchmarks.evidence.masks import BINARY, EXACT, ROUGH, MaskRow, mask_section
from benchmarks.evidence.page import PAGE, evidence_page, write_evidence
from benchmarks.evidence.result_files import IMAGES, Evidence, SceneFacts, read_evidence
from benchmarks.evidence.scene_sets import JUDGING, TUNING, SetRow, sets_section
from benchmarks.evidence.surface_parts import ALL, PartRow, finish_section, start_section
from benchmarks.masks import replace_masks
from mgsr.bench.csv_rows import read_csv, write_csv
from mgsr.bench.results import Curve, Row, keep_rows, write_rows
from tests.bench.samples import sample_row, sample_rows

ROOT = Path(__file__).resolve().parents[2]
RESULTS, DOCS = ROOT / "benchmarks" / "results", ROOT / "docs"
MAKE = "make it anew: python -m benchmarks.evidence"


def page_of(rows: list[Row], curves: tuple[Curve, ...] = ()) -> str:
    scenes = [SceneFacts("apple", "round", 5.0, 0.8, 12.0), SceneFacts("pear", "less so", 10.0, 0.7, 13.0)]
    return evidence_page(Evidence(rows, list(curves), scenes, []))


def test_the_committed_page_is_what_the_committed_results_give() -> None:
    assert evidence_page(read_evidence(RESULTS)) == (DOCS / PAGE).read_text(encoding="utf-8"), MAKE


@pytest.mark.slow
def test_the_committed_plots_are_what_the_committed_results_give(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="PLOTS NEED THE EXTRA bench")
    write_evidence(RESULTS, tmp_path)
    made = {path.name: path.read_bytes() for path in (tmp_path / IMAGES).iterdir()}
    assert made == {path.name: path.read_bytes() for path in (DOCS / IMAGES).iterdir()}, MAKE


def test_every_picture_of_the_page_is_there() -> None:
    text = (DOCS / PAGE).read_text(encoding="utf-8")
    named = {line.rpartition("](")[2].rstrip(")") for line in text.splitlines() if line.startswith("![")}
    assert named == {path.relative_to(DOCS).as_posix() for path in (DOCS / IMAGES).iterdir()}


def test_a_changed_result_changes_the_page(tmp_path: Path) -> None:
    shutil.copytree(RESULTS, tmp_path / "results")
    path = tmp_path / "results" / "scenes.csv"
    path.write_text(path.read_text().replace(",6.54,", ",5.54,"))
    assert "(5.54)" in evidence_page(read_evidence(tmp_path / "results"))


def test_a_finding_holds_where_every_scene_says_so() -> None:
    rows = sample_rows()  # K has half a dB less PSNR on both scenes
    line = next(line for line in page_of(rows).splitlines() if "(row K)" in line)
    assert "**holds**: PSNR better on 2, worse on 0 of 2 scenes (mean gain +0.50 dB" in line
    assert "**no difference**: Chamfer better on 0, worse on 0 of 2 scenes" in line


def test_what_was_not_run_is_said_to_be_so() -> None:
    page = page_of(sample_rows())
    assert (
        "| N | no TV losses | not run |" in page
        and "Losses of total variation help (row N). These rows were not run." in page
    )
    assert "These presets have no run here: high." in page and "paper-photo" in page


def test_row_b_is_the_method_2dgs() -> None:
    line = next(line for line in page_of(sample_rows()).splitlines() if line.startswith("| B |"))
    assert "| 2 | 30.00 (-4.00) |" in line and "90.16 (-0.44)" in line


def test_what_is_bad_comes_first_and_only_where_it_is_so() -> None:
    page = page_of(sample_rows())
    assert page.index("## Weaknesses") < page.index("## The surface")
    assert "no better than with the 2D branch alone: Chamfer better on 0, worse on 2" in page
    better = [replace(row, chamfer=3.0) if row.method == "2dgs" else row for row in sample_rows()]
    assert "no better than with the 2D branch alone: Chamfer" not in page_of(better)
    harmed = [*sample_rows(), sample_row("plum", split_psnr=28.0, split_gain=-1.25)]
    assert "The light split does harm" not in page and "plum -1.25 dB" in page_of(harmed)


def test_seconds_of_a_busy_machine_are_not_compared() -> None:
    rows = [*sample_rows(), sample_row("apple", "L", seconds=350.0), sample_row("pear", "L", seconds=380.0)]
    line = next(line for line in page_of(rows).splitlines() if "(row L)" in line)
    assert "**holds**: time better on 2, worse on 0 of 2 scenes (mean gain +65 s" in line
    busy = [replace(row, others=1.4) if row.variant == "L" else row for row in rows]
    line = next(line for line in page_of(busy).splitlines() if "(row L)" in line)
    assert "the machine was busy" in line and "+65" not in line


def test_a_difference_smaller_than_that_of_seeds_does_not_count() -> None:
    rows = [*sample_rows(), *(replace(sample_row(scene, psnr=36.0), seed=1) for scene in ("apple", "pear"))]
    spread = seed_spread(rows, "psnr")
    assert spread == pytest.approx(2**0.5)  # of 34 and 36
    found = compare(plain_runs(rows), plain_runs(rows, variant="K"), "psnr")
    assert verdict(found, spread) == "no difference beyond the spread between seeds" and verdict(found, 0.1) == "holds"


def test_runs_of_different_commits_are_not_compared() -> None:
    rows = [replace(row, commit="def") if row.variant == "K" else row for row in sample_rows()]
    lines = page_of(rows).splitlines()
    finding, row = (next(line for line in lines if part in line) for part in ("(row K)", "| K |"))
    assert "These rows were not run" in finding and "not run" in row


def test_an_older_row_is_held_against_a_run_of_its_commit() -> None:
    """Check that an older row is compared with a run of its commit, here of another seed."""
    rows = [replace(row, commit="def") if row.variant == "K" else row for row in sample_rows()]
    rows += [replace(sample_row(scene, psnr=33.0), commit="def", seed=1) for scene in ("apple", "pear")]
    row = next(line for line in page_of(rows).splitlines() if "| K |" in line)
    assert "33.50 (+0.50)" in row


def test_when_a_run_was_near_its_best() -> None:
    curve = Curve(sample_row("apple").key, ((50.0, 30.0), (120.0, 33.95), (200.0, 34.0)))
    assert "| apple | mgsr | standard | 200 | 120 | 60% | 34.00 |" in page_of(sample_rows(), (curve,))


def test_gains_are_those_of_the_rounded_figures() -> None:
    first, second = ({"apple": sample_row("apple", chamfer=value)} for value in (2.5049, 2.5051))
    found = compare(first, second, "chamfer")
    assert found is not None and found.gains["apple"] == pytest.approx(0.01)


def test_what_a_run_left_out_is_held_against_it_scene_by_scene() -> None:
    more = [sample_row("pear", "need-light", seconds=450.0, psnr=34.02, chamfer=2.6), sample_row("pear", "L")]
    more[0] = replace(more[0], gaussians=30000)
    page = page_of([*sample_rows(), *more])
    line = next(line for line in page.splitlines() if "each splat's own reflection in every scene" in line)
    assert "| pear | 34.02 (+0.02) | 2.60 (+0.10) | 98.00 (+0.00) | 50000 (+25%) | 450 (+50%) |" in line
    assert "| warm-ups never stop early | pear | 34.00 (+0.00) |" in page
    assert "each splat's own reflection in every scene" not in page_of(sample_rows())


def test_runs_with_a_time_budget_say_whether_they_kept_it() -> None:
    runs = [sample_row("apple", f"time_budget={given}", seconds=taken) for given, taken in ((60, 57.0), (120, 130.0))]
    page = page_of([*sample_rows(), *runs])
    assert "to 105% of the budget. 1 of 2 did." in page
    assert "| apple | 60 | 57 | 95% |" in page and "| apple | 120 | 130 | 108% |" in page
    assert "--time-budget" not in page_of(sample_rows())


def test_an_older_run_serves_its_variants_alone(tmp_path: Path) -> None:
    rows = keep_rows(sample_rows(), [replace(sample_row("apple", psnr=35.0), commit="def")])
    shutil.copytree(RESULTS, tmp_path / "results")
    write_rows(tmp_path / "results" / "runs.csv", rows)
    evidence = read_evidence(tmp_path / "results")
    assert [row.psnr for row in evidence.behind] == [34.0] and plain_runs(evidence.rows)["apple"].psnr == 35.0
    line = next(line for line in evidence_page(evidence).splitlines() if "| K |" in line)
    assert "| 2 | 33.50 (-0.50) |" in line


def test_an_older_run_stays_for_another_method_of_its_commit() -> None:
    older = [sample_row("apple"), sample_row("apple", method="2dgs", psnr=30.0)]
    kept = keep_rows(older, [replace(sample_row("apple", psnr=35.0), commit="def")])
    assert [(row.method, row.commit) for row in kept] == [("2dgs", "abc1234"), ("mgsr", "def"), ("mgsr", "abc1234")]
    kept = keep_rows(kept, [replace(sample_row("apple", method="2dgs", psnr=31.0), commit="def")])
    assert [(row.method, row.commit) for row in kept] == [("2dgs", "def"), ("mgsr", "def")]


def test_the_two_sets_and_the_gap_between_them(tmp_path: Path) -> None:
    apple = SetRow("apple", TUNING, "matte", 1.5, 4.0, 3.0, 10.0, 1.1, 2.5, 40.0, "standard", 0, "abc")
    pear = replace(apple, scene="pear", chamfer=2.5, hull_chamfer=10.0)
    fig = replace(apple, scene="fig", set=JUDGING, chamfer=4.4, hull_chamfer=4.0)
    write_csv(tmp_path / "sets.csv", SetRow, [apple, pear, fig], digits=5)
    assert read_csv(tmp_path / "sets.csv", SetRow) == [apple, pear, fig]
    text = sets_section([apple, pear, fig])
    assert text.index("| pear") < text.index("| apple") < text.index("| fig") and "| 2.50 (1.10, 10.00) | 25% |" in text
    assert (
        "tuning set's 2 scenes have a mean Chamfer of 2.00 and a mean normal error of 4.0 degrees, with a mean" in text
    )
    assert "mean facet angle of 2.5." in text
    assert "No scene is worse than its hull." in text
    assert "These scenes are worse than their hull: fig." in text
    assert "Chamfer is 38% of the hull's on the tuning set and 110% on the judging set." in text
    assert "gap" not in sets_section([apple]) and sets_section([]) == ""


def test_a_scene_with_several_seeds_has_their_mean_and_range() -> None:
    apple = SetRow("apple", TUNING, "matte", 1.5, 4.0, 4.0, 10.0, 1.1, 2.5, 40.0, "standard", 0, "abc")
    pear = replace(apple, scene="pear", chamfer=4.0)
    text = sets_section([apple, pear, replace(apple, chamfer=2.5, normal_error=5.0, seed=1)])
    assert "| 2.00, 1.50 to 2.50 (1.10, 4.00) | 50% | 4.5 (2.5, 10.0) |" in text
    assert (
        "tuning set's 2 scenes have a mean Chamfer of 3.00 and a mean normal error of 4.2 degrees, with a mean" in text
    )
    assert "mean facet angle of 2.5." in text


@pytest.mark.parametrize("section", [start_section, finish_section])
def test_what_the_parts_are_worth(section: Callable[[Sequence[PartRow]], str], tmp_path: Path) -> None:
    figures = {("apple", ALL): (2.0, 30.0), ("pear", ALL): (4.0, 20.0)}
    figures |= {("apple", "stereo"): (5.0, 20.0), ("pear", "stereo"): (3.0, 16.0), ("fig", "stereo"): (9.0, 1.0)}
    rows = [PartRow(scene, part, chamfer, 6.0, s, "abc") for (scene, part), (chamfer, s) in figures.items()]
    write_csv(tmp_path / "parts.csv", PartRow, rows, digits=5)
    assert read_csv(tmp_path / "parts.csv", PartRow) == rows
    text = section(rows)
    assert "| stereo | +1.00 | +0.0 | 1 | 1 | apple +3.00 | pear -1.00 | 7.0 |" in text and "2 scenes" in text
    assert section([row for row in rows if row.without != ALL]) == section([]) == ""


def test_what_differing_exposures_cost(tmp_path: Path) -> None:
    rows = [
        ExposureRow("apple", kind, deviation, "draft", psnr, 3.0, 0.9, 6.0, "abc")
        for kind, deviation, psnr in ((EVEN, 0.0, 30.0), (KEPT, 0.3, 27.5), (EVENED, 0.3, 29.9))
    ]
    write_csv(tmp_path / "exposures.csv", ExposureRow, rows, digits=5)
    assert (
        read_csv(tmp_path / "exposures.csv", ExposureRow) == rows and read_csv(tmp_path / "none.csv", ExposureRow) == []
    )
    text = exposure_section(rows)
    assert "cost 2.50 dB without correction, and 0.10 dB with it" in text and "standard deviation 0.3." in text
    assert exposure_section([]) == ""


def test_what_masks_cost(tmp_path: Path) -> None:
    rows = [
        MaskRow("apple", "tuning", masks, error, chamfer, 5.0, 30.0, "standard", "abc")
        for masks, error, chamfer in ((EXACT, 0.01, 1.5), (BINARY, 0.02, 2.0), (ROUGH, 0.9, 4.0))
    ]
    write_csv(tmp_path / "masks.csv", MaskRow, rows, digits=5)
    assert read_csv(tmp_path / "masks.csv", MaskRow) == rows
    assert "| apple | tuning | rough | 0.90 | 4.00 | 5.0 | 30.00 |" in mask_section(rows)
    assert mask_section([]) == ""


def test_masks_are_replaced_by_worse_ones(tmp_path: Path) -> None:
    y, x = np.mgrid[:64, :64] + 0.5
    share = np.clip(20.5 - np.hypot(x - 32, y - 32), 0, 1)
    (tmp_path / "train").mkdir()
    path, errors = tmp_path / "train" / "r_0.png", []
    for deviation in (0.0, 1.0):
        Image.fromarray(np.dstack([np.full((64, 64, 3), 99.0), 255 * share]).astype(np.uint8)).save(path)
        replace_masks(tmp_path, deviation, seed=5)
        pixels = np.array(Image.open(path))
        assert (pixels[..., :3] == 99).all() and set(np.unique(pixels[..., 3])) == {0, 255}
        errors.append(((pixels[..., 3] > 127) != (share >= 0.5)).sum())
    assert errors[0] == 0 and errors[1] > 40
