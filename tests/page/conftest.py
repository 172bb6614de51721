"""A browser, a service without a worker, and results to look at."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, sync_playwright

from tests.page.browser import FLAGS, OTHER_NAME, find_chromium, watched_page
from tests.page.results import make_results
from tests.service.conftest import tiny_archive as tiny_archive
from tests.service.stack import Stack

Opener = Callable[..., AbstractContextManager[Page]]


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    """Yield headless Chromium, as the system has it."""
    chromium = find_chromium()
    if chromium is None:
        pytest.skip("the page is not tested: no Chromium on the path (apt install chromium)")
    with sync_playwright() as playwright:
        found = playwright.chromium.launch(executable_path=chromium, args=FLAGS)
        yield found
        found.close()


@pytest.fixture(scope="session")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    """Yield a service of API and queue; tests play the worker."""
    with Stack(tmp_path_factory.mktemp("page"), workers=0, MGSR_ALLOWED_HOSTS=OTHER_NAME) as running:
        yield running


@pytest.fixture
def visit(browser: Browser, service: Stack) -> Opener:
    """Provide a function that opens the page at an address of the service."""

    def opened(address: str = "/", url: str = service.url, **context: object) -> AbstractContextManager[Page]:
        return watched_page(browser, url + address, **context)

    return opened


@pytest.fixture(scope="session")
def results(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """Provide the result files of a small made-up job with a light split, by name."""
    return make_results(tmp_path_factory.mktemp("results"))


@pytest.fixture
def capture_folder(tmp_path: Path) -> Path:
    """Build a folder as people have them: photographs in a subfolder, long and foreign names, litter."""
    folder = tmp_path / "Teekanne"
    (folder / "images").mkdir(parents=True)
    (folder / "transforms.json").write_text("{}")
    (folder / "images" / "0001.png").write_bytes(os.urandom(3000))
    (folder / "images" / "täßchen 茶.png").write_bytes(os.urandom(512))
    (folder / "images" / f"{'long' * 40}.png").write_bytes(os.urandom(1))
    (folder / ".DS_Store").write_bytes(b"litter")
    return folder
