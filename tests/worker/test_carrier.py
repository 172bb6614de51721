"""What a running job leaves in the store, and what the next attempt gets of it."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from service.contract.jobs import Jobs, attempt_path
from service.contract.settings import Settings
from service.contract.store import Store
from worker.attempt import Attempt
from worker.carrier import Carrier

JOB = "0" * 32


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store(Settings(home=tmp_path / "home", redis_url="redis://none").store_url, 5.0)


def carrier(store: Store, scratch: Path, attempt: int) -> Carrier:
    jobs: Any = SimpleNamespace(store=store)
    return Carrier(jobs, JOB, 1, attempt, scratch)


def write(path: Path, text: str) -> None:
    """Replace a file as the job does, so that it is another file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".partial.{path.name}")
    partial.write_text(text)
    partial.replace(path)


def fetched(store: Store, scratch: Path, attempt: int) -> dict[str, str]:
    """Return the files, by their names below the results' folder, that an attempt begins with."""
    store.upload("archive", _file(scratch / "given"))
    record = SimpleNamespace(id=JOB, archive="archive")
    itself: Any = Attempt.__new__(Attempt)
    itself._context = SimpleNamespace(retrying_jobs=Jobs(store))
    itself._record, itself._attempt, itself._scratch = record, attempt, scratch
    itself._fetch()
    out = scratch / "out"
    return {path.relative_to(out).as_posix(): path.read_text() for path in out.rglob("*") if path.is_file()}


def _file(path: Path) -> Path:
    path.parent.mkdir(parents=True)
    path.write_text("archive")
    return path


def test_the_next_attempt_begins_with_checkpoint_and_cameras(store: Store, tmp_path: Path) -> None:
    out = tmp_path / "one/out"
    write(out / "checkpoint", "trained")
    write(out / "cameras/images/frame_000001.jpg", "picture")
    write(out / "cameras/database.db", "matches")
    sender = carrier(store, tmp_path / "one", 1)
    sender.send_checkpoint()
    sender.send_cameras()
    assert fetched(store, tmp_path / "early", 2) == {"checkpoint": "trained"}, "a search without a state is not known"

    write(out / "cameras/search.json", json.dumps({"finished": False}))
    sender.send_cameras()
    assert fetched(store, tmp_path / "two", 2) == {
        "checkpoint": "trained",
        "cameras/images/frame_000001.jpg": "picture",
        "cameras/database.db": "matches",
        "cameras/search.json": '{"finished": false}',
    }
    # The second attempt trains on; its cameras are the newest that are complete.
    write(tmp_path / "two/out/checkpoint", "trained on")
    carrier(store, tmp_path / "two", 2).send_checkpoint()
    begun = fetched(store, tmp_path / "three", 3)
    assert begun["checkpoint"] == "trained on" and begun["cameras/database.db"] == "matches"


def test_only_what_has_changed_is_sent_and_the_state_last(store: Store, tmp_path: Path) -> None:
    out = tmp_path / "one/out"
    for name in ("search.json", "sparse/0/images.bin", "database.db"):
        write(out / "cameras" / name, "old")
    sent: list[str] = []
    recording: Any = SimpleNamespace(upload=lambda key, path: sent.append(key))
    sender = carrier(recording, tmp_path / "one", 1)
    sender.send_cameras()
    names = ["cameras/database.db", "cameras/sparse/0/images.bin", "cameras/search.json"]
    assert sent == [attempt_path(JOB, 1, name) for name in names]
    sent.clear()
    sender.send_cameras()
    assert sent == []
    write(out / "cameras/database.db", "new")
    sender.send_cameras()
    assert sent == [attempt_path(JOB, 1, "cameras/database.db")]
