"""From a person's files to a job."""

from __future__ import annotations

import base64
import io
import json
import random
import re
import tarfile
import tempfile
from pathlib import Path

import pytest
from playwright.sync_api import FilePayload, Page, Request, Route, expect

from service.contract.archives import Archives
from service.contract.jobs import Jobs
from service.contract.settings import Settings
from service.contract.store import Store
from tests.page.browser import OTHER_NAME, until
from tests.page.conftest import Opener
from tests.page.puppet import Puppet
from tests.service.hostile import Gate
from tests.service.stack import Stack
from tests.worker.archives import zip_of

pytestmark = pytest.mark.slow
ARCHIVE = "input[type=file]:not([webkitdirectory])"
FOLDER = "input[webkitdirectory]"


def zip_file(name: str = "kettle.zip", size: int = 2000) -> FilePayload:
    return {"name": name, "mimeType": "application/zip", "buffer": zip_of(("image.png", bytes(size)))}


def start(page: Page) -> dict[str, object]:
    """Press Start, wait for the job's page, and return what the service knows of the job."""
    page.get_by_role("button", name="Start", exact=True).click()
    page.wait_for_url(re.compile("#/jobs/"))
    expect(page.locator("main").get_by_text("queue").first).to_be_visible()
    job = page.url.rpartition("/")[2]
    started: dict[str, object] = page.evaluate("job => fetch('/jobs/' + job).then(answer => answer.json())", job)
    return started


def sent(service: Stack, job: str) -> bytes:
    """Return the archive as it lies in the store."""
    store = Store(Settings(home=service.folder, redis_url=service.server.url).store_url, 5.0)
    record = Jobs(store).record(job)
    assert record is not None
    with tempfile.NamedTemporaryFile() as file:
        Archives(store).download(record.archive, Path(file.name))
        return file.read()


def members(archive: bytes) -> dict[str, bytes]:
    with tarfile.open(fileobj=io.BytesIO(archive)) as held:
        opened = {item.name: held.extractfile(item) for item in held}
        return {name: file.read() for name, file in opened.items() if file is not None}


def files_of(folder: Path) -> dict[str, bytes]:
    found = [path for path in folder.rglob("*") if path.is_file() and not path.name.startswith(".")]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in found}


def test_an_archive_with_the_options_that_were_chosen(visit: Opener) -> None:
    with visit() as page:
        page.set_input_files(ARCHIVE, zip_file())
        page.get_by_label("Name").fill("copper kettle")
        page.get_by_role("radio", name="Draft").check()
        page.get_by_text("More settings").click()
        page.get_by_label("Method").select_option("2dgs")
        page.get_by_label("Most triangles").fill("20000")
        page.get_by_label("Masks").select_option("off")
        page.get_by_label("Close holes").select_option("on")
        page.get_by_text("Every setting").click()
        page.get_by_label("Seed").fill("7")
        page.get_by_label("Find a setting").fill("light residual")
        ratio = page.get_by_label("Max light residual")
        expect(ratio).to_have_attribute("placeholder", "none")  # as the draft has it
        ratio.fill("0.7")
        expect(page.get_by_label("Seed")).to_be_hidden()
        job = start(page)
        expect(page.get_by_role("heading", level=1)).to_have_text("copper kettle")
    options = job["options"]
    assert isinstance(options, dict)
    assert (options["preset"], options["method"], options["name"]) == ("draft", "2dgs", "copper kettle")
    assert options["seed"] == 7
    assert options["settings"] == {
        "data.masks": "off",
        "mesh.max_faces": 20000,
        "mesh.close_holes": True,
        "mesh.max_light_residual": 0.7,
    }


def test_a_wrong_value_is_shown_wherever_it_is(visit: Opener, service: Stack) -> None:
    """Check a wrong value in a closed part of the form, and where the search hides it."""
    before = len(service.http.get("/jobs?limit=200").json()["jobs"])
    with visit() as page:
        page.set_input_files(ARCHIVE, zip_file())
        page.get_by_text("More settings").click()
        page.get_by_text("Every setting").click()
        wrong = page.get_by_label("Max light residual")
        wrong.fill("much")
        page.get_by_label("Find a setting").fill("seed")
        page.get_by_text("More settings").click()
        expect(wrong).to_be_hidden()
        page.get_by_role("button", name="Start", exact=True).click()
        expect(wrong).to_be_visible()
        expect(wrong).to_be_focused()
    assert len(service.http.get("/jobs?limit=200").json()["jobs"]) == before


def test_what_a_newer_service_knows_shows_up_by_itself(visit: Opener) -> None:
    """Check that a setting and a job option unknown to the page appear with their meaning."""

    def newer(route: Route) -> None:
        known = route.fetch().json()
        known["settings"]["mesh.sparkle"] = {"type": "number", "default": 0.5, "description": "how much it sparkles"}
        known["options"]["properties"]["urgency"] = {"$ref": "#/$defs/Urgency", "default": "low"}
        known["options"]["$defs"]["Urgency"] = {"enum": ["low", "high"], "description": "whose turn it is"}
        route.fulfill(json=known)

    with visit() as page:
        page.route("**/options", newer)
        page.reload()
        page.set_input_files(ARCHIVE, zip_file())
        page.get_by_text("More settings").click()
        page.get_by_text("Every setting").click()
        sparkle, urgency = page.get_by_label("Sparkle"), page.get_by_label("Urgency")
        expect(sparkle).to_have_attribute("placeholder", "0.5")
        expect(sparkle).to_have_accessible_description("how much it sparkles")
        expect(urgency).to_have_accessible_description("whose turn it is")
        sparkle.fill("0.75")
        urgency.select_option("high")
        with page.expect_request(lambda request: request.method == "POST") as sending:
            page.get_by_role("button", name="Start", exact=True).click()
        metadata = dict(pair.split(" ") for pair in sending.value.headers["upload-metadata"].split(","))
        options = json.loads(base64.b64decode(metadata["options"]))
        assert options["settings"] == {"mesh.sparkle": 0.75} and options["urgency"] == "high"
        expect(page.get_by_role("alert")).to_contain_text("One of the options is invalid.")  # by this service


def test_a_folder_arrives_as_it_is(visit: Opener, service: Stack, capture_folder: Path) -> None:
    """Check a sent folder by Python's own tarfile."""
    with visit() as page:
        page.set_input_files(FOLDER, capture_folder)
        expect(page.locator("main").get_by_text("4 files")).to_be_visible()
        job = start(page)
    assert job["name"] == "Teekanne"
    assert members(sent(service, str(job["id"]))) == files_of(capture_folder)


def test_from_another_machine_without_https(visit: Opener, service: Stack, capture_folder: Path) -> None:
    with visit(url=f"http://{OTHER_NAME}:{service.port}") as page:
        assert not page.evaluate("isSecureContext")
        page.set_input_files(FOLDER, capture_folder)
        job = start(page)
        Puppet(service, str(job["id"])).train(0.5)
        expect(page.locator("main").get_by_text("50 %")).to_be_visible()


def test_a_folder_can_be_dropped(visit: Opener, service: Stack, capture_folder: Path) -> None:
    with visit() as page:
        box = page.locator(".zone").bounding_box()
        assert box is not None
        devtools = page.context.new_cdp_session(page)
        drop = {"items": [], "files": [str(capture_folder)], "dragOperationsMask": 1}
        for kind in ("dragEnter", "dragOver", "drop"):
            place = {"x": box["x"] + 50, "y": box["y"] + 50}
            devtools.send("Input.dispatchDragEvent", {"type": kind, "data": drop, **place})
        expect(page.locator("main").get_by_text("4 files")).to_be_visible()
        job = start(page)
    assert members(sent(service, str(job["id"]))) == files_of(capture_folder)


def test_what_is_no_archive_is_refused_in_words(visit: Opener, service: Stack) -> None:
    before = len(service.http.get("/jobs?limit=200").json()["jobs"])
    with visit() as page:
        page.set_input_files(ARCHIVE, {"name": "holiday.zip", "mimeType": "application/zip", "buffer": b"x" * 1000})
        page.get_by_role("button", name="Start", exact=True).click()
        alert = page.get_by_role("alert").filter(has_text="This file is neither an archive")
        expect(alert).to_be_visible()
        alert.get_by_role("button", name="Dismiss").click()
        expect(alert).to_have_count(0)
    assert len(service.http.get("/jobs?limit=200").json()["jobs"]) == before


def test_what_is_too_large_is_not_sent(visit: Opener) -> None:
    with visit("/#/") as page:
        page.route("**/options", lambda route: route.fulfill(json={**route.fetch().json(), "max_upload": 1000}))
        page.reload()
        page.set_input_files(ARCHIVE, zip_file(size=5000) | {"buffer": b"PK" + bytes(5000)})
        expect(page.get_by_role("alert")).to_contain_text(
            "This capture has 5.0 kB, but the service accepts at most 1.0 kB."
        )
        expect(page.get_by_role("button", name="Start", exact=True)).to_have_count(0)


def slow_down(page: Page, rate: int) -> None:
    """Limit a page's uploads to a rate in bytes a second."""
    devtools = page.context.new_cdp_session(page)
    slow = {"offline": False, "latency": 0, "downloadThroughput": -1, "uploadThroughput": rate}
    devtools.send("Network.enable")
    devtools.send("Network.emulateNetworkConditions", slow)


def test_progress_is_shown_and_an_upload_can_be_cancelled(visit: Opener, service: Stack) -> None:
    before = len(service.http.get("/jobs?limit=200").json()["jobs"])
    with visit() as page:
        slow_down(page, 200_000)
        page.set_input_files(ARCHIVE, zip_file() | {"buffer": b"PK" + bytes(2_000_000)})
        page.get_by_role("button", name="Start", exact=True).click()
        bar = page.get_by_role("progressbar", name="Upload")
        expect(bar).to_be_visible()
        until(page, "document.querySelector('#upload progress').value > 0.1")
        assert 0.1 < float(bar.evaluate("bar => bar.value")) < 1
        page.get_by_role("button", name="Cancel upload").click()
        expect(bar).to_have_count(0)
    assert len(service.http.get("/jobs?limit=200").json()["jobs"]) == before


def test_an_upload_that_is_cut_three_times_goes_on_by_itself(visit: Opener, service: Stack, tmp_path: Path) -> None:
    """Break the page's connections while it sends; what arrives is what was picked."""
    archive = zip_of(("noise.bin", random.Random(1).randbytes(40 << 20)), packed=False)
    (tmp_path / "noise.zip").write_bytes(archive)
    gate = Gate(service.port)
    gate.open()
    with visit(url=f"http://127.0.0.1:{gate.port}") as page:
        slow_down(page, 8_000_000)
        page.set_input_files(ARCHIVE, tmp_path / "noise.zip")
        page.get_by_role("button", name="Start", exact=True).click()
        for share in (0.1, 0.4, 0.7):
            until(page, f"document.querySelector('#upload progress').value > {share}")
            gate.close()
            page.wait_for_timeout(200)
            gate.open()
        page.wait_for_url(re.compile("#/jobs/"))
        job = page.url.rpartition("/")[2]
    gate.close()
    assert sent(service, job) == archive


def test_an_upload_goes_on_after_the_page_was_closed(visit: Opener, service: Stack, tmp_path: Path) -> None:
    """Close the page while it sends; a new page that is given the same folder sends only what is missing."""
    noise = random.Random(2).randbytes(40 << 20)
    (tmp_path / "vase").mkdir()
    for number in range(2):
        (tmp_path / "vase" / f"{number}.jpg").write_bytes(noise[number * (20 << 20) :][: 20 << 20])
    with visit() as page:
        slow_down(page, 8_000_000)
        page.set_input_files(FOLDER, tmp_path / "vase")
        page.get_by_role("button", name="Start", exact=True).click()
        until(page, "document.querySelector('#upload progress').value > 0.5")
        context = page.context
        page.close()
        again = context.new_page()
        asked: list[Request] = []
        again.on("request", lambda request: asked.append(request))
        again.goto(service.url)
        again.set_input_files(FOLDER, tmp_path / "vase")
        job = start(again)
    sending = [request for request in asked if "/uploads" in request.url]
    assert [request.method for request in sending] == ["HEAD", "PATCH", "POST"], "no second upload"
    assert int(sending[1].headers["upload-offset"]) > 10 << 20
    assert members(sent(service, str(job["id"]))) == files_of(tmp_path / "vase")
