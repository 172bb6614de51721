"""Tests of what ending earlier saves and gives away, with made-up rows."""

from __future__ import annotations

from dataclasses import replace

import pytest

from benchmarks.evidence.training_length import early_ends, length_section
from tests.bench.samples import sample_row


def test_what_an_earlier_end_saves_and_gives_away() -> None:
    rows = [sample_row("apple"), sample_row("pear")]
    rows += [sample_row("apple", "H", seconds=210.0, psnr=33.8, chamfer=2.5)]
    rows += [sample_row("pear", "H", seconds=240.0, psnr=34.0, chamfer=2.6)]
    (half,) = early_ends(rows)
    assert (half.scenes, half.saved, half.psnr_lost) == pytest.approx((2, 0.25, 0.1))
    assert half.chamfer_lost == pytest.approx(0.02)
    assert not half.pays
    assert "None does" in length_section(rows)
    assert "| half of the mutual phase | 2 | 25% | 0.10 | 2.0% |" in length_section(rows)


def test_one_that_pays_is_named() -> None:
    rows = [sample_row("apple"), sample_row("apple", "G", seconds=200.0, psnr=33.95, chamfer=2.51)]
    assert early_ends(rows)[0].pays
    assert "This does: a quarter of the mutual phase." in length_section(rows)


def test_the_own_rule_is_held_against_runs_that_never_stop() -> None:
    rows = [sample_row("apple", seconds=200.0, psnr=33.9), sample_row("apple", "L", seconds=250.0)]
    (own,) = early_ends(rows)
    assert (own.saved, own.psnr_lost) == pytest.approx((0.2, 0.1))


def test_neither_busy_runs_nor_other_commits_count() -> None:
    plain, shorter = sample_row("apple"), sample_row("apple", "H", seconds=200.0, others=1.0)
    assert early_ends([plain, shorter]) == []
    shorter = replace(sample_row("apple", "H", seconds=200.0), commit="def5678")
    assert early_ends([plain, shorter]) == []
    assert length_section([plain, shorter]) == ""
