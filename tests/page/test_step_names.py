"""The steps and stages that a job reports have words on the page."""

from __future__ import annotations

import re
from pathlib import Path

from mgsr.training.stage_scheduler import FINISH
from worker.reporting import AFTER, BEFORE

WORDS = Path(__file__).resolve().parents[2] / "service" / "page" / "src" / "parts" / "words.ts"
OF_THE_SERVICE = {"fetch", "publish", "cameras"}


def worded(table: str) -> set[str]:
    """Return the names that a table of the page's words has."""
    found = re.search(rf"const {table}: Record<string, string> = {{(.*?)}};", WORDS.read_text(), re.DOTALL)
    assert found is not None
    return set(re.findall(r"^\s+(\w+):", found[1], re.MULTILINE))


def test_every_step_has_words() -> None:
    assert {*BEFORE, *AFTER, *OF_THE_SERVICE} <= worded("STEPS")


def test_the_last_stage_has_words() -> None:
    assert FINISH in worded("STAGES")
