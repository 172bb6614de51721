"""Photographs and videos without cameras, sent to a whole service."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests.data.corner import picture, poses, save_pictures
from tests.data.films import film
from tests.service.stack import TINY_OPTIONS, Stack, zip_folder

pytest.importorskip("pycolmap")


def results(stack: Stack, job: str) -> set[str]:
    """Return the names of a finished job's results."""
    listed: list[dict[str, Any]] = stack.http.get(f"/jobs/{job}/artifacts").json()["artifacts"]
    return {artifact["name"] for artifact in listed}


def send_video(stack: Stack, video: bytes, kind: str) -> str:
    """Send a video as the body of the request, and return the job's id."""
    options = json.dumps(TINY_OPTIONS | {"name": "walk"})
    answer = stack.http.post("/jobs", params={"options": options}, content=video, headers={"Content-Type": kind})
    assert answer.status_code == 202, answer.text
    return str(answer.json()["id"])


@pytest.mark.slow
def test_an_archive_of_photographs_becomes_a_mesh_and_cameras(stack: Stack, tmp_path: Path) -> None:
    save_pictures(tmp_path / "room")
    job = stack.submitted(zip_folder(tmp_path / "room"), TINY_OPTIONS)
    stack.wait_for(job, "running", step="cameras")
    done = stack.wait_for(job, "succeeded", seconds=280)
    assert any("the cameras were found from the photographs" in note for note in done["metrics"]["notes"])
    names = results(stack, job)
    assert {"mesh.ply", "cameras/search.json", "cameras/sparse/0/images.bin"} <= names
    assert "cameras/database.db" not in names


@pytest.mark.slow
def test_a_video_becomes_a_mesh(stack: Stack, tmp_path: Path) -> None:
    path = film(tmp_path / "walk.webm", [picture(pose) for pose in poses(40)])
    job = send_video(stack, path.read_bytes(), "video/webm")
    stack.wait_for(job, "succeeded", seconds=280)
    names = results(stack, job)
    assert "mesh.ply" in names and sum(name.startswith("cameras/images/frame_") for name in names) >= 8


def test_a_cut_off_video_fails_with_its_reason(stack: Stack, tmp_path: Path) -> None:
    whole = film(tmp_path / "walk.mp4", [picture(pose) for pose in poses(8)]).read_bytes()
    failed = stack.wait_for(send_video(stack, whole[: len(whole) // 2], "video/mp4"), "failed")
    assert failed["error"]["code"] == "bad_scene" and not failed["error"]["retryable"]
    assert "walk.mp4: the video is damaged or cut off" in failed["error"]["message"]


def test_other_files_are_refused_at_once(stack: Stack) -> None:
    answer = stack.http.post("/jobs", content=b"RIFF....AVI LIST" + bytes(600), headers={"Content-Type": "video/mp4"})
    assert answer.status_code == 422 and answer.json()["code"] == "archive_unsupported"
    assert "or a video as mp4, mov, webm or mkv" in answer.json()["detail"]
