"""Server-sent events: in order, to all, and resumed where a connection ended."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.page.puppet import Puppet
from tests.service.stack import TINY_OPTIONS, Stack

Event = tuple[str, str, dict[str, Any]]


def listen(stack: Stack, job: str, after: str | None = None) -> Iterator[Event]:
    """Yield id, kind and data of each event until the stream ends."""
    headers = {} if after is None else {"Last-Event-ID": after}
    with stack.http.stream("GET", f"/jobs/{job}/events", headers=headers) as answer:
        assert answer.headers["Content-Type"].startswith("text/event-stream")
        fields: dict[str, str] = {}
        for line in answer.iter_lines():
            name, _, value = line.partition(": ")
            if line:
                fields[name] = value
            elif "data" in fields:
                yield fields.get("id", ""), fields["event"], json.loads(fields["data"])
                fields = {}


def test_the_first_event_is_newer_than_the_cached_state(tmp_path: Path, tiny_archive: bytes) -> None:
    """Progress between the cached state and the begin of the watch reaches the watcher."""
    with Stack(tmp_path, workers=0) as stack:
        job = stack.submitted(tiny_archive, TINY_OPTIONS)
        puppet = Puppet(stack, job)
        assert stack.http.get(f"/jobs/{job}").json()["progress"] == 0
        puppet.train(0.2)
        _, kind, data = next(listen(stack, job))
        assert (kind, data["status"], data["progress"]) == ("job", "running", 0.2)


@pytest.mark.slow
def test_from_submit_to_the_end(stack: Stack, tiny_archive: bytes) -> None:
    job = stack.submitted(tiny_archive, TINY_OPTIONS)
    heard: list[list[Event]] = [[], [], []]
    threads = [threading.Thread(target=lambda own: own.extend(listen(stack, job)), args=(own,)) for own in heard]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(120)
    for events in heard:
        assert events[0][1] == "job" and events[-1][1] == "job"
        assert events[-1][2]["status"] == "succeeded" and events[-1][2]["progress"] == 1.0
        progress = [data for _, kind, data in events if kind == "progress"]
        assert [data["progress"] for data in progress] == sorted(data["progress"] for data in progress)
        assert {"train", "mesh", "publish"} <= {data["step"] for data in progress}
        ids = [tuple(map(int, number.split("-"))) for number, kind, _ in events if kind == "progress"]
        assert ids == sorted(set(ids))
        assert not any("curve" in data for data in progress)
    assert [event for event in heard[0] if event[0]][-3:] == [event for event in heard[1] if event[0]][-3:]


@pytest.mark.slow
def test_what_was_missed_comes_first(stack: Stack, tiny_archive: bytes) -> None:
    job = stack.submitted(tiny_archive, TINY_OPTIONS)
    first: list[Event] = []
    for event in listen(stack, job):
        first.append(event)
        if event[1] == "progress" and event[2]["step"] == "load":
            break
    rest = list(listen(stack, job, after=first[-1][0]))
    again = list(listen(stack, job, after="0-0"))  # from the beginning, of a job that has ended
    numbered = [event[0] for event in [*first, *rest] if event[0]]
    assert len(numbered) == len(set(numbered))
    everything = [event[0] for event in again if event[0]]
    begin = everything.index(numbered[0])  # the first connection began with what came after it
    assert everything[begin : begin + len(numbered)] == numbered
    assert rest[-1][2]["status"] == again[0][2]["status"] == "succeeded"


def test_a_last_event_id_that_is_none_is_refused(stack: Stack, tiny_archive: bytes) -> None:
    job = stack.submitted(tiny_archive, TINY_OPTIONS)
    answer = stack.http.get(f"/jobs/{job}/events", headers={"Last-Event-ID": "yesterday"})
    assert answer.status_code == 422 and answer.headers["Content-Type"] == "application/problem+json"
    stack.http.delete(f"/jobs/{job}")
