"""Fail unless a tag, the package's version and a heading of CHANGELOG.md agree.

python scripts/check_version.py v0.1.0
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def package_version() -> str:
    """Return the version in mgsr/__init__.py, which is its only definition."""
    found = re.search(r'__version__ = "([^"]+)"', (ROOT / "mgsr/__init__.py").read_text(encoding="utf-8"))
    assert found is not None
    return found[1]


def disagreement(tag: str) -> str | None:
    """Return a message on how a tag disagrees with the sources, or None."""
    version = package_version()
    if tag != f"v{version}":
        return f"tag: expected v{version}, the version in mgsr/__init__.py, got {tag}"
    if f"## {version}" not in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8").splitlines():
        return f"CHANGELOG.md has no heading '## {version}'"
    return None


if __name__ == "__main__":
    sys.exit(disagreement(sys.argv[1]))
