"""One trace from the request over the queue to the steps of the job, by the SDK's exporter in memory."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from fastapi.testclient import TestClient
from opentelemetry.sdk.trace import ReadableSpan, TracerProvider
from opentelemetry.sdk.trace.export import SimpleSpanProcessor
from opentelemetry.sdk.trace.export.in_memory_span_exporter import InMemorySpanExporter
from opentelemetry.trace import StatusCode

from service.app import create_app
from service.contract.errors import SetupError
from service.contract.queue import connect
from service.contract.settings import Settings
from service.contract.telemetry import ENDPOINTS, open_telemetry
from tests.service.stack import TINY_OPTIONS, Stack
from tests.worker.archives import zip_of
from worker.rq_worker import MgsrWorker, StopSignals

ARCHIVE = zip_of(("readme.txt", b"nothing"))  # which the job refuses once it has unpacked it


@pytest.fixture
def settings(tmp_path: Path) -> Iterator[Settings]:
    """Provide settings with a queue server that runs."""
    stack = Stack(tmp_path, workers=0)
    stack.start("queue")
    found = Settings(home=tmp_path, redis_url=stack.server.url)
    try:
        for _ in range(100):
            if (tmp_path / "queue/valkey.sock").exists():
                break
            connect(stack.server.url).ping()
        yield found
    finally:
        stack.stop("queue")


def test_request_queue_job_and_steps_are_one_trace(settings: Settings) -> None:
    exporter, provider = InMemorySpanExporter(), TracerProvider()
    provider.add_span_processor(SimpleSpanProcessor(exporter))
    client = TestClient(create_app(settings, provider), base_url="http://127.0.0.1")
    options = str(TINY_OPTIONS["preset"])
    answer = client.post(
        "/jobs",
        params={"options": f'{{"preset": "{options}"}}'},
        content=ARCHIVE,
        headers={"Content-Type": "application/zip"},
    )
    assert answer.status_code == 202
    MgsrWorker(["cpu"], settings, StopSignals(), provider).work(burst=True, logging_level="WARNING")
    spans: dict[str, ReadableSpan] = {span.name: span for span in exporter.get_finished_spans()}
    request, queue, job = spans["POST /jobs"], spans["queue"], spans["job"]
    steps = [span for name, span in spans.items() if name.startswith("step ")]
    assert {"step fetch", "step unpack"} <= {span.name for span in steps}
    assert {span.context.trace_id for span in (queue, job, *steps)} == {request.context.trace_id}
    assert [span.parent.span_id for span in (queue, job) if span.parent] == [request.context.span_id] * 2
    assert {span.parent.span_id for span in steps if span.parent} == {job.context.span_id}
    assert job.attributes is not None and job.attributes["mgsr.job"] == answer.json()["id"]
    assert job.status.status_code is StatusCode.ERROR and "bad_scene" in str(job.status.description)
    assert queue.start_time is not None and queue.end_time is not None and job.start_time is not None
    assert queue.start_time < queue.end_time <= job.start_time


def test_it_is_off_without_an_endpoint(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ENDPOINTS:
        monkeypatch.delenv(name, raising=False)
    assert open_telemetry("mgsr-service") is None


def test_an_endpoint_without_the_packages_is_told_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(ENDPOINTS[0], "http://127.0.0.1:1")
    monkeypatch.setitem(__import__("sys").modules, "opentelemetry.exporter.otlp.proto.http.trace_exporter", None)
    with pytest.raises(SetupError, match=r"mgsr\[telemetry\]"):
        open_telemetry("mgsr-service")
