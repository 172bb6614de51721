"""The photographs of a job on its page: thumbnails, masks, cameras in three dimensions."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Locator, Page, expect

from mgsr.data.scene import Scene
from mgsr.inspection.findings import Inspection
from mgsr.inspection.inspect import inspect_scene
from mgsr.pipeline.progress import Event
from service.contract.settings import Settings
from service.contract.store import Store
from service.keys import Keys
from tests.inspection.room import Room, room_scene
from tests.page.browser import keep_picture, until
from tests.page.conftest import Opener
from tests.page.puppet import Puppet
from tests.service.stack import Stack
from tests.worker.archives import zip_of
from worker.reporting import Reporter

pytestmark = pytest.mark.slow

FINDING = {
    "code": "contradictory_pose",
    "severity": "warning",
    "text": "the poses of 1 of 28 photographs contradict what they show",
    "amount": 1.0,
    "unit": "photographs",
    "cure": "leave it out",
    "photographs": ["005"],
    "places": [[0.0, 0.0, 3.0]],
}


@pytest.fixture(scope="module")
def scene() -> Scene:
    """Provide photographs of a ball in a room, with masks."""
    room = Room.drawn()
    views = [replace(view, alpha=mask) for view, mask in zip(room.views, room.masks, strict=True)]
    return room_scene(views)


@pytest.fixture(scope="module")
def inspection(scene: Scene) -> Inspection:
    return inspect_scene(scene)


def files(folder: Path, *events: Event) -> Path:
    """Return a folder of what a worker writes about these events."""
    reporter = Reporter(folder, lambda kind, **data: None, lambda event: None)
    for event in events:
        reporter(event)
    return folder


@pytest.fixture
def checked(service: Stack) -> Iterator[Puppet]:
    """Yield the puppet of a job whose photographs were checked, and which trains."""
    job = service.submitted(zip_of(("image.png", b"x")), {"name": "room"})
    puppet = Puppet(service, job)
    puppet.check([FINDING])
    yield puppet
    puppet.stop_as_asked()


def opened(page: Page) -> Locator:
    """Open the photographs, and return the list of thumbnails."""
    page.get_by_text("The photographs and their cameras").click()
    thumbs = page.get_by_role("list").filter(has=page.get_by_role("button", name="000"))
    expect(thumbs.get_by_role("button")).to_have_count(28)
    return thumbs


# The mean light of a square of a picture that is a thumbnail's background, 0..255.
LIGHT = """async (thumb) => {
    const address = thumb.style.backgroundImage.slice(5, -2);
    const image = new Image();
    await new Promise((done, fail) => { image.onload = done; image.onerror = fail; image.src = address; });
    const canvas = document.createElement('canvas');
    const context = canvas.getContext('2d');
    context.drawImage(image, 0, 0);
    const data = context.getImageData(0, 0, image.width, image.height).data;
    return data.reduce((sum, value) => sum + value, 0) / data.length;
}"""


def test_thumbnails_masks_and_cameras(
    service: Stack, visit: Opener, scene: Scene, inspection: Inspection, checked: Puppet, tmp_path: Path
) -> None:
    plain = replace(
        scene,
        train=[replace(view, alpha=None) for view in scene.train],
        test=[replace(view, alpha=None) for view in scene.test],
    )
    events = Event("check", "", inspection=inspection, scene=plain), Event("object", "", scene=scene)
    checked.show_photographs(files(tmp_path / "check", events[0]))
    with visit(f"/#/jobs/{checked.job}") as page:
        thumbs = opened(page)
        expect(page.get_by_role("group", name="Pictures")).to_have_count(0)
        marked = thumbs.get_by_role("button", name="005: warning")
        marked.click()
        expect(marked).to_have_attribute("aria-pressed", "true")
        said = page.get_by_role("status").filter(has_text="005:")
        expect(said).to_contain_text("px from the epipolar lines")
        expect(said).to_contain_text("The poses of 1 of 28 photographs contradict")
        light = marked.evaluate(LIGHT)
        checked.show_photographs(files(tmp_path / "object", *events))
        checked.tell(step="background", text="", progress=0.05)
        page.get_by_role("radio", name="Masks").check(force=True)
        assert marked.evaluate(LIGHT) < 0.8 * light, "what is not the object is dark"
        page.get_by_role("button", name="Show the cameras in 3D").click()
        canvas = page.get_by_role("application", name="Cameras in 3D")
        expect(canvas).to_be_visible()
        until(page, "document.querySelector('.cameras .viewer').dataset.selected === '005'")
        drawn = until(page, "Number(document.querySelector('.cameras .viewer').dataset.frames)")
        keep_picture(page, "cameras")
        canvas.press("ArrowLeft")
        until(page, f"Number(document.querySelector('.cameras .viewer').dataset.frames) > {drawn}")
        choose_by_click(page, canvas)


def choose_by_click(page: Page, canvas: Locator) -> None:
    """Click over the view until a camera is hit; its photograph is then the chosen one."""
    box = canvas.bounding_box()
    assert box is not None
    for step in range(400):
        x, y = box["x"] + box["width"] * (step % 20 + 0.5) / 20, box["y"] + box["height"] * (step // 20 + 0.5) / 20
        page.mouse.click(x, y)
        name = page.evaluate("document.querySelector('.cameras .viewer').dataset.selected")
        if name != "005":
            expect(page.get_by_role("button", name=name, exact=True)).to_have_attribute("aria-pressed", "true")
            return
    raise AssertionError("no camera was hit")


def test_on_a_phone(visit: Opener, scene: Scene, inspection: Inspection, checked: Puppet, tmp_path: Path) -> None:
    checked.show_photographs(files(tmp_path / "check", Event("check", "", inspection=inspection, scene=scene)))
    with visit(f"/#/jobs/{checked.job}", viewport={"width": 390, "height": 844}, color_scheme="dark") as page:
        opened(page)
        expect(page.get_by_role("radio", name="Masks")).to_have_count(1)
        page.get_by_role("button", name="Show the cameras in 3D").click()
        until(page, "document.querySelector('.cameras .viewer')?.dataset.frames > 0")
        assert page.evaluate("document.documentElement.scrollWidth") <= 390
        keep_picture(page, "cameras-phone")


def test_what_is_not_there_yet_comes_with_the_next_step(
    visit: Opener, scene: Scene, inspection: Inspection, checked: Puppet, tmp_path: Path
) -> None:
    with visit(f"/#/jobs/{checked.job}") as page:
        checked.check([FINDING])
        page.get_by_text("The photographs and their cameras").click()
        expect(page.get_by_role("alert")).to_contain_text("This file does not exist yet.")
        checked.show_photographs(files(tmp_path / "check", Event("check", "", inspection=inspection, scene=scene)))
        checked.tell(step="start", text="", progress=0.03)
        expect(page.get_by_role("button", name="000")).to_be_visible()
        expect(page.get_by_role("alert")).to_have_count(0)


def test_the_route_belongs_to_the_key(tmp_path: Path, scene: Scene, inspection: Inspection) -> None:
    store = Store(Settings(home=tmp_path / "home", redis_url="redis://unused").store_url, 5.0)
    keys = Keys(store)
    (one, _), (other, _) = keys.create("one"), keys.create("other")
    with Stack(tmp_path / "home", workers=0) as stack:
        mine, theirs = ({"Authorization": f"Bearer {token}"} for token in (one, other))
        stack.http.headers.update(mine)
        job = stack.submitted(zip_of(("image.png", b"x")), {})
        puppet = Puppet(stack, job)
        assert stack.http.get(f"/jobs/{job}/photographs").json()["code"] == "not_yet"
        puppet.show_photographs(files(tmp_path / "check", Event("check", "", inspection=inspection, scene=scene)))
        found = stack.http.get(f"/jobs/{job}/photographs")
        content: dict[str, Any] = found.json()
        assert len(content["photographs"]) == 28 and content["masks"]
        again = stack.http.get(f"/jobs/{job}/photographs", headers={"If-None-Match": found.headers["ETag"]})
        assert again.status_code == 304
        sheet = stack.http.get(f"/jobs/{job}/previews/photographs.webp")
        assert sheet.headers["Content-Type"] == "image/webp" and len(sheet.content) < 1 << 20
        for address in ("photographs", "previews/photographs.webp", "previews/masks.webp"):
            assert stack.http.get(f"/jobs/{job}/{address}", headers=theirs).status_code == 404
            assert stack.http.get(f"/jobs/{job}/{address}", headers={"Authorization": ""}).status_code == 401
