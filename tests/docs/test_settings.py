"""Settings that the documentation names: each exists and takes the value that it gives."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from mgsr.config import make_config

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
ASSIGNMENT = re.compile(r"`(?:--set )?([a-z_][\w.]*=[\w.\-]+)`")


def named_settings() -> list[str]:
    return sorted({found for page in PAGES for found in ASSIGNMENT.findall(page.read_text(encoding="utf-8"))})


@pytest.mark.parametrize("setting", named_settings())
def test_a_run_takes_the_setting(setting: str) -> None:
    make_config(overrides=[setting])


def test_there_are_such_settings() -> None:
    assert len(named_settings()) > 10
