"""A job from submit to mesh, over HTTP."""

from __future__ import annotations

import gzip
import hashlib
import io
import json
import subprocess
import time
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx
import pytest
import trimesh
from PIL import Image

from tests.service.stack import LONG_OPTIONS, ROOT, STOPPED, TINY_OPTIONS, Stack
from tests.worker.archives import plain, tar_of, zst


@pytest.fixture(scope="module")
def done(stack: Stack, tiny_archive: bytes) -> dict[str, Any]:
    """Provide a job that has succeeded."""
    answer = stack.submit(tiny_archive, TINY_OPTIONS | {"name": "three spheres"})
    assert answer.status_code == 202
    job = answer.json()
    assert answer.headers["Location"] == f"/jobs/{job['id']}"
    assert job["status"] in ("queued", "running")
    return stack.wait_for(job["id"], "succeeded")


def test_a_real_reconstruction_ends_in_a_mesh(stack: Stack, done: dict[str, Any]) -> None:
    answer = stack.http.get(f"/jobs/{done['id']}/mesh.ply")
    mesh = trimesh.load_mesh(io.BytesIO(answer.content), file_type="ply")
    assert len(mesh.faces) > 500
    # The three spheres reach 0.6 to both sides on two axes and up to 0.85 elsewhere.
    assert mesh.extents.min() > 0.8 and mesh.extents.max() < 2.2
    assert done["progress"] == 1.0 and done["metrics"]["mesh"]["faces"] == len(mesh.faces)
    assert done["finished"] > done["created"] and done["error"] is None


def test_every_result_is_listed_and_whole(stack: Stack, done: dict[str, Any]) -> None:
    listed = stack.http.get(f"/jobs/{done['id']}/artifacts").json()["artifacts"]
    names = {artifact["name"] for artifact in listed}
    assert {"mesh.ply", "model.glb", "splats_2d.ply", "report.html", "report.json", "renders/test/r_0.png"} <= names
    assert "checkpoint" not in names
    for artifact in listed:
        data = stack.http.get(f"/jobs/{done['id']}/artifacts/{artifact['name']}").content
        assert len(data) == artifact["size"] and hashlib.sha256(data).hexdigest() == artifact["sha256"]


@pytest.mark.parametrize("name", ["model.glb", "splats.ply", "report.html", "report.json", "log.txt"])
def test_results_have_addresses_of_their_own(stack: Stack, done: dict[str, Any], name: str) -> None:
    answer = stack.http.get(f"/jobs/{done['id']}/{name}")
    assert answer.status_code == 200 and len(answer.content) > 200


@pytest.mark.parametrize("name", ["log.txt", "report.json", "report.html"])
def test_no_result_knows_the_machine(stack: Stack, done: dict[str, Any], name: str) -> None:
    """Check that no result names the worker's folders, which mean nothing to its reader and are private."""
    text = stack.http.get(f"/jobs/{done['id']}/artifacts/{name}").text
    assert len(text) > 100 and str(stack.folder) not in text and "three_spheres" in text


def test_renders_are_pictures(stack: Stack, done: dict[str, Any]) -> None:
    answer = stack.http.get(f"/jobs/{done['id']}/renders/test/r_0.png")
    assert answer.headers["Content-Type"] == "image/png"
    assert Image.open(io.BytesIO(answer.content)).size == (32, 32)


def test_a_part_of_a_file(stack: Stack, done: dict[str, Any]) -> None:
    address = f"/jobs/{done['id']}/mesh.ply"
    whole = stack.http.get(address).content
    for header, expected in (
        ("bytes=10-19", whole[10:20]),
        ("bytes=-7", whole[-7:]),
        (f"bytes={len(whole) - 5}-", whole[-5:]),
    ):
        part = stack.http.get(address, headers={"Range": header})
        assert part.status_code == 206 and part.content == expected
        assert part.headers["Content-Range"].endswith(f"/{len(whole)}")
    outside = stack.http.get(address, headers={"Range": f"bytes={len(whole)}-"})
    assert outside.status_code == 416 and outside.json()["code"] == "range_outside"
    assert outside.headers["Content-Range"] == f"bytes */{len(whole)}"


def test_a_file_that_one_has_is_not_sent_again(stack: Stack, done: dict[str, Any]) -> None:
    address = f"/jobs/{done['id']}/mesh.ply"
    tag = stack.http.get(address).headers["ETag"]
    assert stack.http.get(address, headers={"If-None-Match": tag}).status_code == 304
    changed = stack.http.get(address, headers={"Range": "bytes=0-3", "If-Range": '"other"'})
    assert changed.status_code == 200  # the part would belong to another file


def test_an_unchanged_job_is_not_sent_again(stack: Stack, done: dict[str, Any]) -> None:
    tag = stack.http.get(f"/jobs/{done['id']}").headers["ETag"]
    assert stack.http.get(f"/jobs/{done['id']}", headers={"If-None-Match": tag}).status_code == 304


def test_all_looks_at_a_job_are_answered_alike_and_counted(stack: Stack, done: dict[str, Any]) -> None:
    """Check that repeated requests have equal answers: the first reads the store, those right after it don't."""
    counted = '{method="GET",route="/jobs/{job_id}",status="200"} '
    begin = float(stack.http.get("/metrics").text.partition(counted)[2].split()[0])
    answers = [stack.http.get(f"/jobs/{done['id']}") for _ in range(3)]
    assert len({(answer.content, answer.headers["ETag"], answer.headers["Content-Type"]) for answer in answers}) == 1
    assert float(stack.http.get("/metrics").text.partition(counted)[2].split()[0]) == begin + 3


def test_what_is_not_there_is_a_problem(stack: Stack, done: dict[str, Any]) -> None:
    for address, code in (
        ("/jobs/" + "0" * 32, "job_unknown"),
        ("/jobs/nonsense", "job_unknown"),
        (f"/jobs/{done['id']}/artifacts/secret.txt", "artifact_unknown"),
        (f"/jobs/{done['id']}/artifacts/../job.json", "not_found"),
        (f"/jobs/{done['id']}/artifacts/..%2f..%2f..%2fjob.json", "artifact_unknown"),
        (f"/jobs/{done['id']}/renders/..%2freport.json", "artifact_unknown"),
        (f"/jobs/{done['id']}/splats_3d.ply", "artifact_unknown"),
        ("/nothing", "not_found"),
    ):
        answer = stack.http.get(address)
        assert answer.status_code == 404, address
        assert answer.headers["Content-Type"] == "application/problem+json"
        assert answer.json()["code"] == code, address


def test_a_job_that_ended_is_neither_cancelled_nor_retried(stack: Stack, done: dict[str, Any]) -> None:
    assert stack.http.delete(f"/jobs/{done['id']}").json()["code"] == "job_ended"
    retry = stack.http.post(f"/jobs/{done['id']}/retry")
    assert retry.status_code == 409 and retry.json()["code"] == "not_retryable"


@pytest.mark.slow
def test_progress_that_a_person_believes(stack: Stack, tiny_archive: bytes) -> None:
    """Check stage, iteration, time left, losses, PSNR, curve, pictures and the log during training, and a cancel."""
    watch = {"train.watch.curve_every": 50, "train.watch.preview_every": 50}
    options = LONG_OPTIONS | {"settings": LONG_OPTIONS["settings"] | watch}
    job = stack.submitted(tiny_archive, options)
    seen = stack.wait_for(job, "running", step="train")
    while seen["psnr"] is None or len(seen["curve"]) < 3:
        seen = stack.wait_for(job, "running", step="train")
    assert seen["stage"] == "warmup_surfels" or seen["stage"] == "alone"
    assert 0 < seen["iteration"] < seen["total"] and 0 < seen["progress"] < 0.9
    assert seen["losses"] and all(value >= 0 for value in seen["losses"].values())
    assert seen["memory_bytes"] > 50e6 and seen["splats"]["surfels"] > 0
    later = stack.wait_for(job, "running", step="train")
    while later["iteration"] <= seen["iteration"] or later["eta_seconds"] is None:
        later = stack.wait_for(job, "running", step="train")
    assert later["progress"] >= seen["progress"] and later["eta_seconds"] > 0
    for name in ("render", "normals"):
        picture = _until_there(stack, f"/jobs/{job}/previews/{name}.webp")
        assert Image.open(io.BytesIO(picture.content)).size == (32, 32)
    known = stack.job(job)
    assert set(known["previews"]) == {"render", "normals"} and known["previews"]["render"] % 50 == 0
    assert known["training_seconds"] >= later["training_seconds"] > 0
    assert b"surfels" in _until_there(stack, f"/jobs/{job}/log.txt").content
    assert stack.http.get(f"/jobs/{job}/mesh.ply").json()["code"] == "no_results"
    stack.http.delete(f"/jobs/{job}")
    assert stack.wait_for(job, "cancelled", seconds=STOPPED)["curve"]


def _until_there(stack: Stack, address: str) -> httpx.Response:
    for _ in range(150):
        answer = stack.http.get(address)
        if answer.status_code == 200:
            return answer
        time.sleep(0.1)
    raise AssertionError(f"{address}: {answer.text}")


@pytest.mark.slow
@pytest.mark.parametrize("kind", [".tar", ".tar.gz", ".tar.zst"])
@pytest.mark.parametrize("form", [True, False], ids=["form", "body"])
def test_every_kind_of_archive_ends_in_a_mesh(stack: Stack, tiny_archive: bytes, kind: str, form: bool) -> None:
    """Check every kind of archive but zip, which other tests send, as a browser's form and as the body."""
    archive = tar_of(*[plain(name, data) for name, data in zip_members(tiny_archive)])
    packings: dict[str, tuple[Callable[[bytes], bytes], str]] = {
        ".tar": (bytes, "application/x-tar"),
        ".tar.gz": (gzip.compress, "application/gzip"),
        ".tar.zst": (zst, "application/zstd"),
    }
    pack, name = packings[kind]
    if form:
        job = stack.submitted(pack(archive), TINY_OPTIONS)
    else:
        query, head = {"options": json.dumps(TINY_OPTIONS)}, {"Content-Type": name}
        answer = stack.http.post("/jobs", params=query, content=pack(archive), headers=head)
        assert answer.status_code == 202, answer.text
        job = answer.json()["id"]
    assert stack.wait_for(job, "succeeded")["metrics"]["mesh"]["faces"] > 500


def zip_members(archive: bytes) -> list[tuple[str, bytes]]:
    """Return name and content of each file."""
    with zipfile.ZipFile(io.BytesIO(archive)) as opened:
        return [(name, opened.read(name)) for name in opened.namelist()]


@pytest.mark.slow
def test_by_curl_as_the_documentation_says(stack: Stack, tiny_archive: bytes, tmp_path: Path) -> None:
    """Check the block of docs/service.md, run with another address, archive and options."""
    text = (ROOT / "docs/service.md").read_text(encoding="utf-8")
    script = text.split("<!-- curl -->\n```sh\n")[1].split("```")[0]
    script = script.replace("http://127.0.0.1:8000", stack.url).replace('{"preset": "draft"}', json.dumps(TINY_OPTIONS))
    (tmp_path / "scene.zip").write_bytes(tiny_archive)
    ran = subprocess.run(["bash", "-euc", script], cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert ran.returncode == 0, ran.stderr
    assert (tmp_path / "mesh.ply").read_bytes().startswith(b"ply")
