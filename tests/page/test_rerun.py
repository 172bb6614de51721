"""Findings of the check, a draft and then a final from one upload, and the estimate of a dry run."""

from __future__ import annotations

import json
import re

import pytest
from playwright.sync_api import expect

from tests.page.conftest import Opener
from tests.page.puppet import Puppet
from tests.page.results import METRICS
from tests.service.stack import Stack
from tests.worker.archives import zip_of

pytestmark = pytest.mark.slow

FINDING = {
    "code": "blurred",
    "severity": "warning",
    "text": "2 of 20 photographs are much less sharp than their neighbours",
    "amount": 1.6,
    "unit": "times",
    "cure": "take them again",
    "photographs": ["IMG_3", "IMG_7"],
    "places": [],
}
ESTIMATE = [
    {"preset": preset, "seconds": seconds, "memory_mib": 1024.0, "steps": {}}
    for preset, seconds in (("draft", 40.0), ("standard", 150.0), ("high", 200.0))
]


def test_findings_are_shown_while_the_job_runs(service: Stack, visit: Opener) -> None:
    job = service.submitted(zip_of(("image.png", b"x")), {"name": "vase"})
    puppet = Puppet(service, job)
    with visit(f"/#/jobs/{job}") as page:
        found = page.get_by_role("region", name="Check of the photographs")
        expect(found).to_be_hidden()
        puppet.check([FINDING])
        expect(found).to_contain_text("Warning: 2 of 20 photographs are much less sharp")
        expect(found).to_contain_text("IMG_3, IMG_7")
    puppet.stop_as_asked()


def test_a_final_follows_a_draft_with_one_click(service: Stack, visit: Opener, results: dict[str, bytes]) -> None:
    job = service.submitted(zip_of(("image.png", b"x")), {"name": "vase", "preset": "draft"})
    Puppet(service, job).succeed(results, METRICS)
    with visit(f"/#/jobs/{job}") as page:
        page.get_by_role("button", name="Run again as standard").click()
        page.wait_for_url(re.compile(rf"#/jobs/(?!{job})[0-9a-f]{{32}}$"))
        made = service.job(page.url[-32:])
    assert made["rerun_of"] == job and made["options"]["preset"] == "standard" and made["name"] == "vase"


def test_a_dry_run_offers_each_preset(service: Stack, visit: Opener) -> None:
    job = service.submitted(zip_of(("image.png", b"x")), {"name": "vase", "dry_run": True})
    Puppet(service, job).succeed({"estimate.json": json.dumps(ESTIMATE).encode()}, {"estimate": ESTIMATE})
    with visit(f"/#/jobs/{job}") as page:
        expect(page.get_by_text("standard: up to about 2 min 30 s, 1.1 GB of memory")).to_be_visible()
        page.get_by_role("button", name="Run as high").click()
        page.wait_for_url(re.compile(rf"#/jobs/(?!{job})[0-9a-f]{{32}}$"))
        made = service.job(page.url[-32:])
    assert made["options"]["preset"] == "high" and made["options"]["dry_run"] is False
