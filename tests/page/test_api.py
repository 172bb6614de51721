"""What the API offers for the page, without a browser."""

from __future__ import annotations

import pytest

from tests.page.puppet import Puppet
from tests.service.stack import Stack
from tests.worker.archives import zip_of


@pytest.fixture
def job(service: Stack) -> str:
    """Provide the id of a waiting job."""
    return service.submitted(zip_of(("image.png", b"x")), {"name": "asked"})


def test_a_job_tells_its_pictures_and_the_time_spent_in_training(service: Stack, job: str) -> None:
    assert service.job(job)["previews"] == {} and service.job(job)["training_seconds"] is None
    Puppet(service, job).train(0.5, previews={"render": b"picture"})
    seen = service.wait_for(job, "running", step="train")
    assert seen["previews"] == {"render": 500} and seen["training_seconds"] == 50.0


def test_a_picture_is_sent_again_only_if_it_has_changed(service: Stack, job: str) -> None:
    puppet = Puppet(service, job)
    puppet.train(0.2, previews={"render": b"first"})
    address = f"/jobs/{job}/previews/render.webp"
    first = service.http.get(address)
    known = {"If-None-Match": first.headers["ETag"]}
    again = service.http.get(address, headers=known)
    assert (first.content, again.status_code, again.content) == (b"first", 304, b"")
    puppet.train(0.4, previews={"render": b"second"})
    assert service.http.get(address, headers=known).content == b"second"


def test_options_tell_how_large_an_archive_may_be(service: Stack) -> None:
    assert service.http.get("/options").json()["max_upload"] == 8 << 30


def test_a_report_has_no_origin_wherever_it_is_opened(service: Stack, job: str, results: dict[str, bytes]) -> None:
    """Check that a report's policy denies it an origin: its script could read the key otherwise."""
    Puppet(service, job).succeed(results, {})
    service.finished(job)
    for address in ("report.html", "artifacts/report.html"):
        policy = service.http.get(f"/jobs/{job}/{address}").headers["Content-Security-Policy"]
        assert "sandbox allow-scripts" in policy and "allow-same-origin" not in policy
    assert "Content-Security-Policy" not in service.http.get(f"/jobs/{job}/mesh.ply").headers
