"""A job in each state: waiting, training, stopped, retried, failed, deleted."""

from __future__ import annotations

import io

import pytest
from PIL import Image
from playwright.sync_api import expect

from tests.page.browser import until
from tests.page.conftest import Opener
from tests.page.puppet import Puppet
from tests.service.stack import Stack
from tests.worker.archives import zip_of

pytestmark = pytest.mark.slow


def submitted(service: Stack, name: str) -> str:
    return service.submitted(zip_of(("image.png", b"x")), {"name": name, "preset": "draft"})


def picture(color: str) -> bytes:
    held = io.BytesIO()
    Image.new("RGB", (16, 16), color).save(held, "WEBP", lossless=True)
    return held.getvalue()


SHOWN_COLOR = """image => {
    const canvas = document.createElement('canvas');
    const context = canvas.getContext('2d');
    context.drawImage(image, 0, 0);
    return [...context.getImageData(1, 1, 1, 1).data.slice(0, 3)];
}"""


def test_from_the_queue_to_the_results_without_a_reload(
    visit: Opener, service: Stack, results: dict[str, bytes]
) -> None:
    job = submitted(service, "watched")
    with visit(f"/#/jobs/{job}") as page:
        expect(page.locator(".headline").first).to_contain_text("queue")
        puppet = Puppet(service, job)
        puppet.tell(step="load", text="reading", progress=0.01)
        expect(page.locator("main").get_by_text("Reading the photographs")).to_be_visible()
        puppet.tell(step="start", text="", progress=0.03, step_progress=0.4, step_eta_seconds=24.0)
        expect(page.locator("main").get_by_text("Building the first surface: 40 %")).to_be_visible()
        expect(page.locator("main").get_by_text("3 % · for this step: about 30 s left")).to_be_visible()
        # It runs down by itself while there is no news.
        expect(page.locator("main").get_by_text("3 % · for this step: about 20 s left")).to_be_visible(timeout=15_000)
        puppet.tell(step_progress=None, step_eta_seconds=None)
        puppet.train(0.25, "warmup_surfels", {"render": picture("red")})
        expect(page.locator("main").get_by_text("Training: surfels, warm-up")).to_be_visible()
        expect(page.locator("main").get_by_text("25 % · about 2 min left")).to_be_visible()
        shown = page.get_by_alt_text("Render of a held-out view, so far")
        expect(shown).to_be_visible()
        assert shown.evaluate(SHOWN_COLOR) == [255, 0, 0]
        puppet.train(0.75, "mutual", {"render": picture("blue")})
        expect(page.locator("main").get_by_text("Training: both branches teach each other")).to_be_visible()
        loss = page.get_by_role("img", name="Loss: from 0.2500 to 0.1500 in 1 min 15 s")
        expect(loss).to_be_visible()
        expect(page.get_by_role("img", name="PSNR on held-out photographs: from 20.5 dB to 25.5 dB")).to_be_visible()
        until(page, f"({SHOWN_COLOR})(document.querySelector('.previews img'))[2] === 255")
        puppet.succeed(results, {"psnr_test": 31.42})
        expect(page.locator("main").get_by_text("31.4 dB")).to_be_visible()
        expect(page.locator(".pill")).to_have_text("Done")


def test_cancel_and_retry(visit: Opener, service: Stack) -> None:
    job = submitted(service, "stopped")
    puppet = Puppet(service, job)
    puppet.train(0.4)
    with visit(f"/#/jobs/{job}") as page:
        page.get_by_role("button", name="Cancel", exact=True).click()
        expect(page.locator(".pill")).to_have_text("Stopping")
        assert puppet.asked_to_stop()
        puppet.stop_as_asked()
        expect(page.locator(".pill")).to_have_text("Cancelled")
        page.get_by_role("button", name="Retry").click()
        expect(page.locator(".pill")).to_have_text("Waiting")
        again = Puppet(service, job)
        assert again.round == puppet.round + 1
        again.train(0.5)
        expect(page.locator(".pill")).to_have_text("Running")
        expect(page.locator("main").get_by_text("50 %", exact=False)).to_be_visible()


def test_a_failure_is_told_in_words_with_its_cure(visit: Opener, service: Stack) -> None:
    job = submitted(service, "hungry")
    Puppet(service, job).fail("out_of_memory", "the job used 9000 MiB; use smaller images", retryable=True)
    with visit(f"/#/jobs/{job}") as page:
        expect(page.locator("main").get_by_text("The job needed more memory than it may use.")).to_be_visible()
        expect(page.locator("main").get_by_text("the job used 9000 MiB; use smaller images")).to_be_visible()
        expect(page.locator("main").get_by_text("peak memory: 3.0 GB")).to_be_visible()
        expect(page.get_by_role("button", name="Retry")).to_be_visible()


def test_what_would_fail_again_offers_no_retry(visit: Opener, service: Stack) -> None:
    job = submitted(service, "broken")
    Puppet(service, job).fail("bad_scene", "no cameras in it", retryable=False)
    with visit(f"/#/jobs/{job}") as page:
        expect(page.locator("main").get_by_text("MGSR cannot use this capture.")).to_be_visible()
        expect(page.get_by_role("button", name="Retry")).to_have_count(0)


def test_delete_asks_first(visit: Opener, service: Stack) -> None:
    job = submitted(service, "unwanted")
    Puppet(service, job).fail("bad_scene", "no cameras in it", retryable=False)
    with visit(f"/#/jobs/{job}") as page:
        page.get_by_role("button", name="Delete").click()
        page.get_by_role("dialog").get_by_role("button", name="Keep").click()
        assert service.http.get(f"/jobs/{job}").status_code == 200
        page.get_by_role("button", name="Delete").click()
        page.get_by_role("dialog").get_by_role("button", name="Delete").click()
        expect(page.get_by_role("heading", name="Your jobs")).to_be_visible()
        expect(page.locator("main").get_by_text("unwanted")).to_have_count(0)
    assert service.http.get(f"/jobs/{job}").status_code == 404


def test_the_list_follows_the_jobs(visit: Opener, service: Stack) -> None:
    with visit() as page:
        expect(page.get_by_role("heading", name="Your jobs")).to_be_visible()
        job = submitted(service, "listed")
        row = page.get_by_role("link", name="listed")
        expect(row).to_contain_text("Waiting", timeout=15_000)
        Puppet(service, job).train(0.5)
        expect(row).to_contain_text("50 % · about 50 s left")
        row.click()
        expect(page.get_by_role("heading", level=1)).to_have_text("listed")


def test_an_unknown_job_is_told_so(visit: Opener) -> None:
    with visit(f"/#/jobs/{'0' * 32}") as page:
        expect(page.get_by_role("alert")).to_contain_text("This job does not exist.")
