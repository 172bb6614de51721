"""The page for everyone: by keyboard, for screen readers, on phones, in the dark."""

from __future__ import annotations

import re

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Page, expect

from tests.page.browser import keep_picture
from tests.page.conftest import Opener
from tests.page.puppet import Puppet
from tests.page.results import METRICS
from tests.page.test_upload import ARCHIVE, zip_file
from tests.page.test_watch import submitted
from tests.service.stack import Stack

pytestmark = pytest.mark.slow
PHONE = {"width": 360, "height": 740}


@pytest.fixture(scope="module")
def addresses(service: Stack, results: dict[str, bytes]) -> dict[str, str]:
    """Provide the page's address in each of its states."""
    jobs = {name: submitted(service, name) for name in ("done", "failed", "running")}
    Puppet(service, jobs["done"]).succeed(results, METRICS)
    Puppet(service, jobs["failed"]).fail("empty_mesh", "nothing came out", retryable=True)
    Puppet(service, jobs["running"]).train(0.5)
    return {"home": "/"} | {name: f"/#/jobs/{job}" for name, job in jobs.items()}


def ready(page: Page, state: str) -> None:
    """Wait until the state is complete, with everything that can be opened open."""
    signs = {"home": "Your jobs", "done": "Downloads"}
    if state in signs:
        expect(page.get_by_role("heading", name=signs[state])).to_be_visible()
    else:
        expect(page.locator(".pill")).not_to_have_text("")
    if state == "home":
        page.set_input_files(ARCHIVE, zip_file())
    for summary in page.locator("summary:visible").all():
        summary.click()
    if state == "done":
        page.get_by_role("button", name="Show in 3D").click()
        expect(page.locator(".viewer[data-frames]")).to_be_visible()
        page.get_by_role("radio", name="Lit", exact=True).check(force=True)
        expect(page.get_by_role("slider", name="Turn the light")).to_be_visible()


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("state", ["home", "done", "failed", "running"])
def test_axe_finds_nothing(visit: Opener, addresses: dict[str, str], state: str, scheme: str) -> None:
    """Check the page by axe-core's rules, with contrast, names, landmarks and order of headings."""
    with visit(addresses[state], color_scheme=scheme) as page:
        ready(page, state)
        keep_picture(page, f"{state}-{scheme}")
        found = Axe().run(page, options={"runOnly": ["wcag2a", "wcag2aa", "wcag21aa", "wcag22aa", "best-practice"]})
        assert found.violations_count == 0, found.generate_report()


@pytest.mark.parametrize("state", ["home", "done", "failed", "running"])
def test_nothing_is_wider_than_a_small_phone(visit: Opener, addresses: dict[str, str], state: str) -> None:
    with visit(addresses[state], viewport=PHONE, has_touch=True, is_mobile=True) as page:
        ready(page, state)
        keep_picture(page, f"{state}-phone")
        assert page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]
        small = page.evaluate(
            """() => [...document.querySelectorAll('button, select, summary, main a, .choices label')]
                .filter(element => element.checkVisibility() && element.getBoundingClientRect().height < 43.5)
                .map(element => element.outerHTML)"""
        )
        assert small == []


def test_from_files_to_a_running_job_by_keyboard_alone(visit: Opener, service: Stack) -> None:
    with visit() as page:
        # From the beginning: asked for just before the key, it may come too late.
        page.on("filechooser", lambda chooser: chooser.set_files([zip_file("by keyboard.zip")]))
        expect(page.get_by_role("heading", name="New reconstruction")).to_be_visible()
        page.keyboard.press("Tab")
        expect(page.get_by_role("link", name="Skip to the content")).to_be_focused()
        page.keyboard.press("Enter")
        expect(page.locator("#main")).to_be_focused()
        page.keyboard.press("Tab")
        expect(page.get_by_role("button", name="Choose files")).to_be_focused()
        page.keyboard.press("Enter")
        expect(page.get_by_label("Name")).to_be_focused()
        page.keyboard.press("Tab")
        expect(page.get_by_role("radio", name="Standard")).to_be_focused()
        page.keyboard.press("ArrowLeft")
        expect(page.get_by_role("radio", name="Draft")).to_be_checked()
        page.keyboard.press("Enter")
        page.wait_for_url(re.compile("#/jobs/"))
        expect(page.locator("#main")).to_be_focused()
        Puppet(service, page.url.rpartition("/")[2]).train(0.5)
        page.keyboard.press("Tab")
        page.keyboard.press("Tab")
        expect(page.get_by_role("button", name="Cancel", exact=True)).to_be_focused()
        page.keyboard.press("Enter")
        expect(page.locator(".pill")).to_have_text("Stopping")
        expect(page.locator("#announcer")).to_have_text("Stopping after a checkpoint")


def test_the_viewer_by_keyboard(visit: Opener, addresses: dict[str, str]) -> None:
    with visit(addresses["done"]) as page:
        button = page.get_by_role("button", name="Show in 3D")
        expect(button).to_be_visible()
        button.focus()
        page.keyboard.press("Enter")
        canvas = page.locator(".viewer canvas")
        expect(canvas).to_be_focused()
        seen = {canvas.screenshot()}
        for key in ("ArrowLeft", "ArrowUp", "+", "Shift+ArrowRight", "-"):
            page.keyboard.press(key)
            page.wait_for_timeout(400)
            seen.add(canvas.screenshot())
        assert len(seen) == 6
        page.keyboard.press("Tab")
        expect(page.get_by_role("radio", name="Mesh")).to_be_focused()
        page.keyboard.press("ArrowRight")
        expect(page.locator(".viewer[data-shown=splats]")).to_be_visible()
        page.keyboard.press("ArrowLeft")
        page.keyboard.press("Tab")
        page.keyboard.press("ArrowRight")
        expect(page.get_by_role("radio", name="Lit", exact=True)).to_be_checked()
        page.keyboard.press("Tab")
        page.keyboard.press("Tab")
        expect(page.get_by_role("radio", name="Own light")).to_be_focused()
        lit = canvas.screenshot()
        page.keyboard.press("ArrowRight")
        page.keyboard.press("Tab")
        slider = page.get_by_role("slider", name="Turn the light")
        expect(slider).to_be_focused()
        page.keyboard.press("ArrowRight")
        expect(slider).to_have_attribute("aria-valuetext", "5 degrees")
        page.wait_for_timeout(400)
        assert canvas.screenshot() != lit


def test_every_stop_of_the_keyboard_can_be_seen(visit: Opener, addresses: dict[str, str]) -> None:
    with visit(addresses["done"]) as page:
        ready(page, "done")
        page.locator("#main").focus()
        outlined = """() => {
            const own = document.activeElement;
            const shown = own.matches('.segmented input') ? own.nextElementSibling : own;
            return parseFloat(getComputedStyle(shown).outlineWidth) >= 2 || own.matches('input[type=range]');
        }"""
        for _ in range(30):
            page.keyboard.press("Tab")
            assert page.evaluate(outlined), page.evaluate("document.activeElement.outerHTML")
