"""The results of a job: the viewer, the light split, the report, the files."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Locator, Page, expect

from tests.page.browser import until
from tests.page.conftest import Opener
from tests.page.puppet import Puppet
from tests.page.results import (
    EVEN,
    FAR_MIDDLE,
    FAR_ORIGIN,
    METRICS,
    RED,
    REFLECTED,
    SIZE,
    TRANSMITTED,
    WEIGHT,
    make_results,
)
from tests.service.stack import Stack
from tests.worker.archives import zip_of

pytestmark = pytest.mark.slow


# Of a pixel in the left half and of one in the right, 0..1; read from a copy, as the page's own is not made for it.
RED_AND_ALPHA = """canvas => {
    const context = new OffscreenCanvas(canvas.width, canvas.height).getContext('2d', { willReadFrequently: true });
    context.drawImage(canvas, 0, 0);
    return [12, 36].map(x => {
        const [red, , , alpha] = context.getImageData(x, 24, 1, 1).data;
        return [red / 255, alpha / 255];
    });
}"""


@pytest.fixture(scope="module")
def done(service: Stack, results: dict[str, bytes]) -> str:
    """Provide the address of a job that succeeded."""
    job = service.submitted(zip_of(("image.png", b"x")), {"name": "red box"})
    Puppet(service, job).succeed(results, METRICS)
    return f"/#/jobs/{job}"


@pytest.fixture(scope="module")
def far(service: Stack, tmp_path_factory: pytest.TempPathFactory) -> str:
    """Provide the address of such a job whose frame's origin lies far away."""
    job = service.submitted(zip_of(("image.png", b"x")), {"name": "far red box"})
    results = make_results(tmp_path_factory.mktemp("far"), FAR_MIDDLE, FAR_ORIGIN)
    assert b"comment mgsr origin 512344 4501236 433\n" in results["splats_3d.ply"]
    Puppet(service, job).succeed(results, METRICS)
    return f"/#/jobs/{job}"


def open_viewer(page: Page) -> Locator:
    page.get_by_role("button", name="Show in 3D").click()
    viewer = page.locator(".viewer[data-frames]")
    expect(viewer).to_be_visible()
    return viewer


def settled(page: Page, part: Locator) -> np.ndarray:
    """Return pixels [H,W,3] 0..1 of a part of the page, once two pictures of it are the same."""
    before = b""
    for _ in range(40):
        now = part.screenshot()
        if now == before:
            return np.asarray(Image.open(io.BytesIO(now)).convert("RGB")) / 255
        before = now
        page.wait_for_timeout(250)
    raise AssertionError("the picture never stands still")


def stage(page: Page) -> np.ndarray:
    return settled(page, page.locator(".viewer canvas"))


def red(pixels: np.ndarray) -> np.ndarray:
    """Return where the picture has the box's colour, bool [H,W]."""
    red_pixels: np.ndarray = np.abs(pixels - RED).max(axis=2) < 0.08
    return red_pixels


def sides_of(normals: np.ndarray) -> list[np.ndarray]:
    """Return where the box shows its front and its right side, bool [H,W] each; normals [H,W,3]: that look of it."""
    colors, counts = np.unique((normals * 255).astype(int).reshape(-1, 3), axis=0, return_counts=True)
    largest = [color / 255 for color in colors[np.argsort(counts)[-4:]]]  # three sides and the background
    found = [np.abs(normals - color).max(axis=2) < 0.02 for color in largest if np.ptp(color) > 0.1]
    assert len(found) == 3
    top = min(found, key=lambda side: np.nonzero(side)[0].mean())
    return sorted((side for side in found if side is not top), key=lambda side: float(np.nonzero(side)[1].mean()))


def choose(page: Page, name: str) -> None:
    page.get_by_role("radio", name=name, exact=True).check(force=True)


def test_the_figures(visit: Opener, done: str) -> None:
    with visit(done) as page:
        figures = page.locator("dl.figures")
        for text in ("31.4 dB", "0.951", "12", "400", "1 min 15 s"):
            expect(figures.get_by_text(text, exact=True)).to_be_visible()


def test_the_viewer_is_loaded_only_when_asked_for(visit: Opener, done: str) -> None:
    with visit(done) as page:
        loaded = (
            "performance.getEntriesByType('resource').map(entry => entry.name).filter(name => /viewer-/.test(name))"
        )
        expect(page.get_by_role("button", name="Show in 3D")).to_be_visible()
        assert page.evaluate(loaded) == []
        open_viewer(page)
        assert len(page.evaluate(loaded)) == 1


@pytest.mark.parametrize("job", ["done", "far"])
def test_mesh_and_splats_lie_at_the_same_place(visit: Opener, job: str, request: pytest.FixtureRequest) -> None:
    """Check a red box away from the origin, with red splats inside it."""
    with visit(request.getfixturevalue(job)) as page:
        open_viewer(page)
        mesh = red(stage(page))
        assert 0.05 < mesh.mean() < 0.8
        choose(page, "Splats")
        splats = red(stage(page))
        assert splats.sum() > 0.2 * mesh.sum()
        assert (splats & mesh).sum() > 0.98 * splats.sum()
        choose(page, "Side by side")
        both, middle = red(stage(page)), mesh.shape[1] // 2
        assert (both[:, : middle - 4] == mesh[:, : middle - 4]).mean() > 0.99
        assert (both[:, middle + 4 :] == splats[:, middle + 4 :]).mean() > 0.97


def test_every_look_of_the_surface(visit: Opener, done: str) -> None:
    with visit(done) as page:
        open_viewer(page)
        looks = {"Colour": stage(page)}
        for name in ("Clay", "Normals", "Wireframe"):
            choose(page, name)
            looks[name] = stage(page)
        covered = red(looks["Colour"])
        spread = {name: np.ptp(pixels[covered], axis=1).mean() for name, pixels in looks.items()}
        assert spread["Clay"] < 0.1 < spread["Normals"], spread  # grey, and coloured
        background = looks["Colour"][4, 4]
        empty = np.abs(looks["Wireframe"] - background).max(axis=2)[covered] < 0.02
        assert 0.5 < empty.mean() < 0.999  # lines, and nothing between them


def test_own_light_falls_from_where_it_came_and_turns(visit: Opener, done: str) -> None:
    """Check a lamp between two sides of the box: it lights both alike, and neither when it is turned around."""
    with visit(done) as page:
        open_viewer(page)
        choose(page, "Normals")
        sides = sides_of(stage(page))
        choose(page, "Lit")
        slider = page.get_by_role("slider", name="Turn the light")
        lights = {}
        for degrees in (0, 90, 180, 270):
            slider.fill(str(degrees))
            assert slider.get_attribute("aria-valuetext") == f"{degrees} degrees"
            lit = stage(page)
            lights[degrees] = [float(np.median(lit[side][:, 0])) for side in sides]
        front, right = lights[0]
        assert min(front, right) > 0.3 and abs(front - right) < 0.05, lights
        assert max(lights[180]) < 0.1, lights
        # Anticlockwise, as seen from above: from between front and right to between right and back.
        front, right = lights[90]
        assert front < 0.1 < 0.3 < right, lights
        front, right = lights[270]
        assert right < 0.1 < 0.3 < front, lights


def test_the_studio_lights_every_side(visit: Opener, done: str) -> None:
    with visit(done) as page:
        open_viewer(page)
        expect(page.get_by_role("slider", name="Turn the light")).to_be_hidden()
        choose(page, "Normals")
        sides = sides_of(stage(page))
        choose(page, "Lit")
        choose(page, "Studio light")
        first = stage(page)
        assert all(np.median(first[side][:, 0]) > 0.4 for side in sides)
        page.get_by_role("slider", name="Turn the light").fill("120")
        assert np.abs(stage(page) - first).mean() > 0.005
        choose(page, "Splats")
        expect(page.get_by_role("slider", name="Turn the light")).to_be_hidden()


def test_orbit_by_mouse_and_back(visit: Opener, done: str) -> None:
    with visit(done) as page:
        open_viewer(page)
        before = stage(page)
        box = page.locator(".viewer canvas").bounding_box()
        assert box is not None
        page.mouse.move(box["x"] + 300, box["y"] + 200)
        page.mouse.down()
        page.mouse.move(box["x"] + 450, box["y"] + 230, steps=4)
        page.mouse.up()
        assert np.abs(stage(page) - before).mean() > 0.01
        page.get_by_role("button", name="Reset view").click()
        assert np.abs(stage(page) - before).mean() < 0.002


def test_a_still_viewer_draws_nothing(visit: Opener, done: str) -> None:
    with visit(done) as page:
        viewer = open_viewer(page)
        choose(page, "Splats")
        stage(page)
        page.wait_for_timeout(1000)
        before = viewer.get_attribute("data-frames")
        page.wait_for_timeout(2000)
        assert viewer.get_attribute("data-frames") == before


def test_the_light_split_is_the_sum_of_its_halves(visit: Opener, done: str) -> None:
    """Check pixels of the left half, where nothing is reflected, and of the right, against the numbers put in."""
    added, halfway = WEIGHT * REFLECTED, (EVEN + TRANSMITTED) / 2
    expected = {
        -200: (EVEN, EVEN),
        -150: (halfway, halfway),
        -100: (TRANSMITTED, TRANSMITTED),
        -50: (TRANSMITTED, TRANSMITTED + added / 2),
        0: (TRANSMITTED, TRANSMITTED + added),
        50: (TRANSMITTED / 2, TRANSMITTED / 2 + added),
        100: (0, added),
    }
    with visit(done) as page:
        slider = page.get_by_role("slider", name="From own colour to reflections")
        canvas = page.locator(".light canvas")
        until(page, f"document.querySelector('.light canvas')?.width === {SIZE}")
        for at, (left, right) in expected.items():
            slider.fill(str(at))
            premultiplied = [red * alpha for red, alpha in canvas.evaluate(RED_AND_ALPHA)]
            assert premultiplied == pytest.approx([left, right], abs=3 / 255), at
        assert [alpha for _, alpha in canvas.evaluate(RED_AND_ALPHA)] == [1, 1]  # on black
        page.get_by_role("button", name="Even light", exact=True).click()
        assert slider.input_value() == "-200" and slider.get_attribute("aria-valuetext") == "Even light"
        page.get_by_role("button", name="Full", exact=True).click()
        assert slider.input_value() == "0" and slider.get_attribute("aria-valuetext") == "Full"


def test_files_arrive_byte_by_byte(visit: Opener, done: str, results: dict[str, bytes]) -> None:
    with visit(done) as page:
        for name, saved in (("model.glb", "red_box-model.glb"), ("splats_3d.ply", "red_box-splats_3d.ply")):
            with page.expect_download() as download:
                page.get_by_role("button", name=f"Download {name}").click()
            assert download.value.suggested_filename == saved
            assert Path(download.value.path()).read_bytes() == results[name]
        page.get_by_text("All other files").click()
        expect(page.get_by_role("button", name="Download renders/test/r_0_weight.png")).to_be_visible()


def test_the_report_runs_in_a_frame_without_an_origin(visit: Opener, done: str) -> None:
    with visit(done) as page:
        page.get_by_role("button", name="Open the report").click()
        text = page.frame_locator("iframe").locator("#text")
        expect(text).to_have_text("made-up report")
        expect(text).to_have_css("color", "rgb(0, 128, 0)")
        assert text.evaluate("() => self.origin") == "null"
        page.get_by_role("button", name="Close").click()
        expect(page.locator("iframe")).to_have_count(0)
        expect(page.get_by_role("button", name="Open the report")).to_be_focused()


def test_the_log(visit: Opener, done: str) -> None:
    with visit(done) as page:
        page.get_by_text("Log", exact=True).click()
        expect(page.get_by_role("region", name="Log")).to_have_text("the made-up log")
