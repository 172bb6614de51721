"""Fixtures of the tests of the start."""

from __future__ import annotations

import pytest

from mgsr.shading.light_estimate import LightEstimate
from mgsr.start import masked_surface


@pytest.fixture
def neither_bent_nor_moved(monkeypatch: pytest.MonkeyPatch) -> None:
    """Take the surface as stereo or the hull give it."""
    monkeypatch.setattr(masked_surface, "estimate_light", lambda *given: LightEstimate())
    for name in ("shape_from_shading", "refine_photometrically"):
        monkeypatch.setattr(masked_surface, name, lambda mesh, *rest, **more: mesh)
