"""A service that asks for a key."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from service.contract.settings import Settings
from service.contract.store import Store
from service.keys import Keys
from tests.page.conftest import Opener
from tests.page.puppet import Puppet
from tests.page.results import METRICS
from tests.service.stack import Stack
from tests.worker.archives import zip_of

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def guarded(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Stack, str]]:
    """Yield a service with one key, and the key."""
    folder = tmp_path_factory.mktemp("guarded")
    store = Store(Settings(home=folder, redis_url="redis://unused").store_url, 5.0)
    token, _ = Keys(store).create("tests")
    with Stack(folder, workers=0) as running:
        running.http.headers["Authorization"] = f"Bearer {token}"
        yield running, token


def enter(page: Page, key: str) -> None:
    dialog = page.get_by_role("dialog", name="This service needs a key")
    dialog.get_by_label("API key").fill(key)
    dialog.get_by_role("button", name="Use this key").click()


def test_a_wrong_key_is_told_and_the_right_one_opens(visit: Opener, guarded: tuple[Stack, str]) -> None:
    stack, token = guarded
    with visit(url=stack.url) as page:
        expect(page.get_by_role("dialog")).to_be_visible()
        assert page.evaluate("document.activeElement.type") == "password"
        enter(page, "mgsr_wrong")
        expect(page.get_by_role("dialog").get_by_role("alert")).to_contain_text("The service does not know this key.")
        enter(page, token)
        expect(page.get_by_role("heading", name="New reconstruction")).to_be_visible()
        assert page.evaluate("localStorage.length") == 0 and page.evaluate("document.cookie") == ""
        page.reload()
        expect(page.get_by_role("heading", name="New reconstruction")).to_be_visible()
        expect(page.get_by_role("dialog")).to_have_count(0)


def test_everything_works_with_a_key(visit: Opener, guarded: tuple[Stack, str], results: dict[str, bytes]) -> None:
    """Check that the page loads nothing without the key.

    Browsers can't send it with what they load themselves (pictures, frames, links), so none of that may be used.
    """
    stack, token = guarded
    job = stack.submitted(zip_of(("image.png", b"x")), {"name": "kept"})
    Puppet(stack, job).succeed(results, METRICS)
    with visit(f"/#/jobs/{job}", url=stack.url) as page:
        enter(page, token)
        expect(page.get_by_text("31.4 dB")).to_be_visible()
        with page.expect_download() as download:
            page.get_by_role("button", name="Download mesh.ply").click()
        assert Path(download.value.path()).read_bytes() == results["mesh.ply"]
        page.get_by_role("button", name="Open the report").click()
        expect(page.frame_locator("iframe").locator("#text")).to_have_text("made-up report")


def test_a_key_that_is_taken_back_is_asked_for_anew(visit: Opener, guarded: tuple[Stack, str]) -> None:
    stack, token = guarded
    with visit(url=stack.url) as page:
        enter(page, token)
        expect(page.get_by_role("heading", name="New reconstruction")).to_be_visible()
        page.evaluate("sessionStorage.setItem('mgsr-key', 'mgsr_old')")
        expect(page.get_by_role("dialog").get_by_role("alert")).to_be_visible(timeout=15_000)
