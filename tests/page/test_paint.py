"""The time until the page shows something."""

from __future__ import annotations

import statistics

import pytest
from playwright.sync_api import Browser, expect

from tests.page.browser import until, watched_page
from tests.service.stack import Stack

FIRST_PAINT = "performance.getEntriesByName('first-contentful-paint')[0]?.startTime"
PROMISED_MS = 1000.0  # on loopback


@pytest.mark.slow
def test_first_paint(browser: Browser, service: Stack) -> None:
    """Check the first paint, each time in a new profile, with nothing kept from before."""
    times = []
    for _ in range(5):
        with watched_page(browser, service.url) as page:
            expect(page.get_by_role("heading", name="New reconstruction")).to_be_visible()
            times.append(until(page, FIRST_PAINT))
    middle = statistics.median(times)
    print(f"first contentful paint: {min(times):.0f} to {max(times):.0f} ms, {middle:.0f} ms in the middle")
    assert min(times) < PROMISED_MS  # what else runs on the machine only adds
