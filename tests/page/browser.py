"""A browser that watches for requests to other hosts, breaches of the page's policy, and errors."""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from playwright.sync_api import Browser, ConsoleMessage, Page, Request

# A name of this machine that browsers don't trust as they trust `localhost`: some functions are missing there.
OTHER_NAME = "capture.test"
# As service.md has them: the drawing is done in software, where there is no GPU.
FLAGS = [
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
    "--disable-dev-shm-usage",
    f"--host-resolver-rules=MAP {OTHER_NAME} 127.0.0.1",
]
# The browser itself notes each answer with an error status, and each connection that is refused.
NETWORK_NOTE = "Failed to load resource"


def find_chromium() -> str | None:
    """Return the installed Chromium or Chrome; None without one."""
    names = ("chromium", "chromium-browser", "google-chrome", "chrome")
    return next((path for name in names if (path := shutil.which(name)) is not None), None)


@dataclass
class Watch:
    """A record of what must not happen."""

    host: str
    foreign: list[str] = field(default_factory=list)
    complaints: list[str] = field(default_factory=list)

    def see_request(self, request: Request) -> None:
        """Note a request that goes to another host."""
        address = urlsplit(request.url)
        if address.scheme in ("http", "https", "ws", "wss") and address.netloc != self.host:
            self.foreign.append(request.url)

    def see_message(self, message: ConsoleMessage) -> None:
        """Note a warning or an error; a breach of the policy is one."""
        if message.type in ("error", "warning") and not message.text.startswith(NETWORK_NOTE):
            self.complaints.append(message.text)


def until(page: Page, expression: str, seconds: float = 10.0) -> Any:
    """Wait until an expression is true, and return its value.

    Playwright's own waiting evaluates inside the page, whose policy forbids that.
    """
    ends = time.monotonic() + seconds
    while not (value := page.evaluate(expression)):
        assert time.monotonic() < ends, expression
        page.wait_for_timeout(50)
    return value


def keep_picture(page: Page, name: str) -> None:
    """Save a screenshot of the whole page for people to look at, in the folder MGSR_SCREENSHOTS, where that is set."""
    if folder := os.environ.get("MGSR_SCREENSHOTS"):
        page.screenshot(path=Path(folder) / f"{name}.png", full_page=True)


@contextmanager
def watched_page(browser: Browser, url: str, **context: Any) -> Iterator[Page]:
    """Open a page in a profile of its own, at `url`, and check in the end that nothing forbidden happened."""
    held = browser.new_context(**{"viewport": {"width": 1280, "height": 900}, **context})
    page = held.new_page()
    page.set_default_timeout(20_000)
    watch = Watch(urlsplit(url).netloc)
    held.on("request", watch.see_request)
    page.on("console", watch.see_message)
    page.on("pageerror", lambda error: watch.complaints.append(str(error)))
    page.goto(url)
    try:
        yield page
    finally:
        held.close()
    assert not watch.foreign, watch.foreign
    assert not watch.complaints, watch.complaints
