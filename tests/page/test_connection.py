"""The service goes away while the page is open, and comes back."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import expect

from tests.page.conftest import Opener
from tests.page.puppet import Puppet
from tests.page.test_upload import ARCHIVE, zip_file
from tests.page.test_watch import submitted
from tests.service.stack import Stack

pytestmark = pytest.mark.slow
GONE = "The service does not answer. The page keeps trying"


@pytest.fixture
def own(tmp_path: Path) -> Iterator[Stack]:
    """Yield a service of the test's own, to stop."""
    with Stack(tmp_path, workers=0) as running:
        yield running


def test_a_watched_job_goes_on_where_it_was(visit: Opener, own: Stack) -> None:
    job = submitted(own, "patient")
    puppet = Puppet(own, job)
    puppet.train(0.2)
    with visit(f"/#/jobs/{job}", url=own.url) as page:
        expect(page.locator("main").get_by_text("20 %", exact=False)).to_be_visible()
        own.kill("api")
        expect(page.get_by_text(GONE)).to_be_visible()
        puppet.train(0.5)  # while nobody can look
        own.start("api")
        own.wait_until_ready()
        expect(page.get_by_text(GONE)).to_have_count(0, timeout=15_000)
        expect(page.locator("main").get_by_text("50 %", exact=False)).to_be_visible()
        puppet.train(0.8)
        expect(page.locator("main").get_by_text("80 %", exact=False)).to_be_visible()
        expect(page.get_by_role("img", name="Loss: from 0.2600 to 0.1400")).to_be_visible()


def test_an_upload_goes_on_once_the_service_is_back(visit: Opener, own: Stack) -> None:
    with visit(url=own.url) as page:
        page.set_input_files(ARCHIVE, zip_file())
        own.kill("api")
        page.get_by_role("button", name="Start", exact=True).click()
        expect(page.get_by_text(GONE)).to_be_visible()
        own.start("api")
        own.wait_until_ready()
        expect(page.get_by_text(GONE)).to_have_count(0, timeout=15_000)
        page.wait_for_url(re.compile("#/jobs/"))
    assert len(own.http.get("/jobs").json()["jobs"]) == 1


def test_a_page_that_opens_too_early_waits(visit: Opener, own: Stack) -> None:
    with visit(url=own.url) as page:
        page.route("**/options", lambda route: route.abort())
        page.reload()
        expect(page.get_by_text(GONE)).to_be_visible()
        page.unroute("**/options")
        expect(page.get_by_role("heading", name="New reconstruction")).to_be_visible(timeout=15_000)
