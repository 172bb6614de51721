"""`mgsr demo`: where it looks for the example, and what it says without one."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from mgsr.cli.main import app
from mgsr.pipeline import example
from mgsr.pipeline.example import EXAMPLE, find_example


def test_the_sources_have_the_example() -> None:
    assert (find_example() / "transforms_train.json").is_file()


def _installed(monkeypatch: pytest.MonkeyPatch, package: Path) -> None:
    """Make the package believe that it is installed in a folder."""
    monkeypatch.setattr(example, "__file__", str(package / "pipeline" / "example.py"))


def test_an_installed_package_brings_its_own(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "mgsr" / EXAMPLE).mkdir(parents=True)
    (tmp_path / EXAMPLE).mkdir(parents=True)
    _installed(monkeypatch, tmp_path / "mgsr")
    assert find_example() == tmp_path / "mgsr" / EXAMPLE


def test_without_an_example_it_says_where_it_looked(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    _installed(monkeypatch, tmp_path / "mgsr")
    result = CliRunner().invoke(app, ["demo", "-o", str(tmp_path / "out")])
    assert result.exit_code == 2
    assert str(tmp_path / "mgsr") in result.output and "mgsr run" in result.output
