"""One version, in one place."""

from __future__ import annotations

import tomllib
from pathlib import Path

from mgsr import __version__
from scripts.check_version import disagreement, package_version

ROOT = Path(__file__).resolve().parents[2]


def test_the_package_says_it_and_pyproject_reads_it_there() -> None:
    assert package_version() == __version__
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert "version" in project["project"]["dynamic"]
    assert project["tool"]["scikit-build"]["metadata"]["version"]["input"] == "mgsr/__init__.py"


def test_the_changelog_has_it() -> None:
    assert disagreement(f"v{__version__}") is None
    assert "v9" in str(disagreement("v9"))


def test_the_images_of_the_manifests_carry_it() -> None:
    assert (ROOT / "deploy/kubernetes/kustomization.yaml").read_text().count(f"newTag: {__version__}}}") == 3
