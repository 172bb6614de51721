"""Fixtures that every test may use."""

from __future__ import annotations

from pathlib import Path

import pytest

SHARED_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The measurement scenes that lie beside a checkout; a test that needs them is skipped, and says so, without."""
    if not SHARED_DATA.is_dir():
        pytest.skip(f"NEEDS THE MEASUREMENT SCENES: no folder {SHARED_DATA.parent.name}/data beside the checkout")
    return SHARED_DATA
