"""deploy/env.example and the pages name exactly the variables that the programs read."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

from service.contract.settings import Settings

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = (ROOT / "deploy/env.example").read_text(encoding="utf-8")
# Set by one process for its child, never by a person.
INSIDE = {"MGSR_JOB", "MGSR_JOB_PARENT", "MGSR_WORKER_GPU"}


def _read_by_settings() -> set[str]:
    return {f"MGSR_{name.upper()}" for name in Settings.model_fields}


def _named_in_code() -> set[str]:
    """Return every MGSR_... that stands as a string of its own in the programs.

    These are read without the settings class.
    """
    found: set[str] = set()
    for folder in ("mgsr", "service", "worker", "program"):
        for path in (ROOT / folder).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Constant) and isinstance(node.value, str):
                    found |= set(re.findall(r"^MGSR_[A-Z_]*[A-Z]$", node.value))
    return found


def _listed(text: str) -> list[str]:
    return re.findall(r"^#?((?:MGSR|AWS)_[A-Z_]+)=", text, re.M)


def test_the_example_lists_each_variable_once_and_no_other() -> None:
    listed = [name for name in _listed(EXAMPLE) if name.startswith("MGSR_")]
    assert sorted(listed) == sorted((_read_by_settings() | _named_in_code()) - INSIDE)


@pytest.mark.parametrize("name", _listed(EXAMPLE))
def test_each_is_explained(name: str) -> None:
    """Check that a comment above each variable, or above the group that it ends, explains it."""
    block = next(block for block in re.split(r"\n(?=# )", EXAMPLE) if re.search(rf"^#?{name}=", block, re.M))
    assert block.startswith("# ") and len(block.split("\n", 1)[0]) > 20


def test_the_defaults_that_it_shows_are_the_defaults(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in _read_by_settings():
        monkeypatch.delenv(name, raising=False)
    expected = Settings()
    for name, value in re.findall(r"^#(MGSR_[A-Z_]+)=(.+)$", EXAMPLE, re.M):
        if name in _read_by_settings():
            monkeypatch.setenv(name, value)
    assert Settings() == expected


def test_compose_reads_what_the_example_sets() -> None:
    compose = (ROOT / "docker-compose.yml").read_text(encoding="utf-8")
    wanted = set(re.findall(r"(?<!\$)\$\{([A-Z_]+)", compose))
    assert wanted == set(re.findall(r"^([A-Z_]+)=", EXAMPLE, re.M))
