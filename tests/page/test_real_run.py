"""One real, tiny reconstruction, watched in the browser from the worker's first word to the surface."""

from __future__ import annotations

from pathlib import Path

import pytest
from playwright.sync_api import expect

from tests.page.conftest import Opener
from tests.service.stack import TINY_OPTIONS, Stack

# Starting Python and torch is most of it; a machine that does other things takes its time.
PATIENCE_MS = 240_000


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_watched_from_the_submit_to_the_surface(visit: Opener, tmp_path: Path, tiny_archive: bytes) -> None:
    with Stack(tmp_path) as stack:
        settings = TINY_OPTIONS["settings"] | {"train.watch.curve_every": 10, "train.watch.preview_every": 10}
        job = stack.submitted(tiny_archive, TINY_OPTIONS | {"name": "three spheres", "settings": settings})
        with visit(f"/#/jobs/{job}", url=stack.url) as page:
            expect(page.locator(".pill")).to_have_text("Running", timeout=PATIENCE_MS)
            expect(page.get_by_text("Training", exact=False).first).to_be_visible(timeout=PATIENCE_MS)
            expect(page.locator(".pill")).to_have_text("Done", timeout=PATIENCE_MS)
            expect(page.locator("dl.figures").get_by_text("dB")).to_be_visible()
            page.get_by_role("button", name="Show in 3D").click()
            expect(page.locator(".viewer[data-frames]")).to_be_visible()
            page.get_by_role("radio", name="Splats", exact=True).check(force=True)
            expect(page.locator(".viewer[data-shown=splats]")).to_be_visible()
            page.get_by_role("button", name="Open the report").click()
            expect(page.frame_locator("iframe").get_by_role("heading", level=1)).to_be_visible()
