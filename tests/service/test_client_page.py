"""The programs of docs/client.md, against a service whose worker is a puppet."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.docs.blocks import ROOT, program
from tests.page.puppet import Puppet
from tests.service.stack import Stack

PAGE = ROOT / "docs" / "client.md"
RESULTS = {"mesh.ply": b"ply\n" * 100, "renders/test/0.png": b"png"}


@pytest.fixture(scope="module")
def idle(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    """Yield a service without workers."""
    with Stack(tmp_path_factory.mktemp("idle"), workers=0) as running:
        yield running


@pytest.fixture
def folder(idle: Stack, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Provide a folder with photos/ in it, and a puppet that works on the next job."""
    (tmp_path / "photos/images").mkdir(parents=True)
    (tmp_path / "photos/images/0001.png").write_bytes(bytes(5000))
    monkeypatch.chdir(tmp_path)
    known = {job["id"] for job in idle.http.get("/jobs").json()["jobs"]}
    worker = threading.Thread(target=_play, args=(idle, known), daemon=True)
    worker.start()
    yield tmp_path
    worker.join(30)
    assert not worker.is_alive()


def _play(stack: Stack, known: set[str]) -> None:
    """Work on the first job that is new."""
    new: list[dict[str, Any]] = []
    while not new:
        time.sleep(0.1)
        new = [job for job in stack.http.get("/jobs").json()["jobs"] if job["id"] not in known]
    puppet = Puppet(stack, new[0]["id"])
    puppet.train(0.5)
    time.sleep(1.0)
    puppet.succeed(RESULTS, {"psnr_test": 29.0})


def _fetched(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_the_program_for_notebooks(idle: Stack, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    names: dict[str, Any] = {"server": idle.url, "key": None}
    exec(compile(program(PAGE, "client"), str(PAGE), "exec"), names)
    printed = capsys.readouterr().out.splitlines()
    assert "running 50% train" in printed and printed[-1] == "succeeded 100% done"
    sent, total = map(int, printed[0].split())
    assert sent == total > 5000
    assert _fetched(folder / "out/vase") == RESULTS
    assert sorted(names["files"]) == sorted(Path("out/vase") / name for name in RESULTS)


def test_the_program_with_asyncio(idle: Stack, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    names: dict[str, Any] = {}
    exec(compile(program(PAGE, "asyncio"), str(PAGE), "exec"), names)
    files = asyncio.run(names["reconstruct"](idle.url, None, Path("photos")))
    assert "running 0.5" in capsys.readouterr().out
    assert _fetched(folder / "out/async") == RESULTS and len(files) == len(RESULTS)
