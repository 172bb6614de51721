"""The service keeps to its own document: no 5xx, no answer that is not described."""

from __future__ import annotations

from typing import Any
from urllib.parse import quote

import pytest
import schemathesis
from fastapi import FastAPI
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from hypothesis.errors import Unsatisfiable
from hypothesis.strategies import SearchStrategy
from openapi_spec_validator import validate
from schemathesis import Case, GenerationMode
from schemathesis.checks import not_a_server_error
from schemathesis.specs.openapi.checks import (
    content_type_conformance,
    response_headers_conformance,
    response_schema_conformance,
    status_code_conformance,
)

from service.app import create_app
from service.contract.options import JobOptions
from service.contract.settings import Settings
from service.views import JobView
from tests.service.stack import LONG_OPTIONS, TINY_OPTIONS, Stack
from tests.worker.archives import zip_of

CHECKS = [
    not_a_server_error,
    status_code_conformance,
    content_type_conformance,
    response_headers_conformance,
    response_schema_conformance,
]


# The bytes of a resumable upload go as they are.
schemathesis.serializer.alias("application/offset+octet-stream", "application/octet-stream")

# Addresses of 64 KiB are no HTTP to the server under the app, which refuses them in its own words.
LONGEST = 30_000


@pytest.fixture(scope="module")
def app(tmp_path_factory: pytest.TempPathFactory) -> FastAPI:
    """Provide the app, for its document; nothing is sent to this one."""
    folder = tmp_path_factory.mktemp("document")
    return create_app(Settings(redis_url="redis://127.0.0.1:1", store=str(folder)))


@pytest.fixture(scope="module")
def known_jobs(stack: Stack, tiny_archive: bytes) -> list[str]:
    """Provide a job in each state: succeeded, failed, running."""
    done = stack.submitted(tiny_archive, TINY_OPTIONS)
    failed = stack.submitted(zip_of(("readme.txt", b"nothing")), TINY_OPTIONS)
    running = stack.submitted(tiny_archive, LONG_OPTIONS)
    stack.wait_for(done, "succeeded")
    stack.wait_for(failed, "failed")
    stack.wait_for(running, "running", step="train")
    return [done, failed, running]


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("mode", list(GenerationMode), ids=lambda mode: mode.value)
def test_every_operation_answers_as_described(stack: Stack, known_jobs: list[str], mode: GenerationMode) -> None:
    """Check generated requests, good or bad; most of those about a job name an existing one."""
    document = schemathesis.openapi.from_url(f"{stack.url}/openapi.json")
    found: list[Any] = list(document.get_all_operations())
    operations = [each.ok() for each in found]
    assert len(operations) > 20
    for operation in operations:
        try:
            strategy = operation.as_strategy(generation_mode=mode)
            generated(strategy, stack, known_jobs)
        except Unsatisfiable:
            assert mode is GenerationMode.NEGATIVE and not operation.body, operation.label


def generated(strategy: SearchStrategy[Case[Any]], stack: Stack, known_jobs: list[str]) -> None:
    """Send some dozens of requests of one operation, and check the answers against the document."""

    @settings(max_examples=40, deadline=None, database=None, derandomize=True, suppress_health_check=list(HealthCheck))
    @given(case=strategy, job=st.sampled_from([*known_jobs, None]))
    def check(case: Case[Any], job: str | None) -> None:
        if "job_id" in (case.path_parameters or {}) and job is not None:
            following = case.path.endswith("/events")  # only an ended job's stream ends
            case.path_parameters["job_id"] = known_jobs[0] if following else job
        assume(len(quote(str(case.query))) < LONGEST)
        response = case.call(base_url=stack.url, allow_redirects=False, timeout=30)
        case.validate_response(response, checks=CHECKS)

    check()


def test_the_document_is_valid_openapi(app: FastAPI) -> None:
    validate(app.openapi())


def test_every_operation_has_a_name_and_describes_its_errors(app: FastAPI) -> None:
    operations = [
        (f"{method.upper()} {path}", operation)
        for path, item in app.openapi()["paths"].items()
        for method, operation in item.items()
    ]
    names = [operation["operationId"] for _, operation in operations]
    assert len(set(names)) == len(names) and all(name.isidentifier() for name in names)
    for address, operation in operations:
        assert operation["summary"] or operation["description"], address
        for status, answer in operation["responses"].items():
            if int(status) >= 400:
                assert list(answer["content"]) == ["application/problem+json"], (address, status)


def test_the_addresses_are_those_of_the_documentation(app: FastAPI) -> None:
    paths = set(app.openapi()["paths"])
    assert paths >= {"/jobs", "/jobs/{job_id}", "/jobs/{job_id}/events", "/jobs/{job_id}/retry", "/options", "/metrics"}
    assert paths >= {f"/jobs/{{job_id}}/{name}" for name in ("mesh.ply", "model.glb", "report.html", "log.txt")}


def test_examples_hold_to_their_schemas(app: FastAPI) -> None:
    schemas = app.openapi()["components"]["schemas"]
    assert {"JobView", "JobOptions", "ProblemDetails"} <= set(schemas)
    for example in schemas["JobOptions"]["examples"]:
        JobOptions.model_validate(example)
    example = schemas["JobView"]["example"]
    assert JobView.model_validate(example).status == "running" and set(example) <= set(JobView.model_fields)


def test_options_tell_everything_that_users_set(stack: Stack) -> None:
    found = stack.http.get("/options").json()
    assert set(found["presets"]) == {"draft", "standard", "high"} and set(found["methods"]) == {"mgsr", "2dgs", "3dgs"}
    assert found["settings"]["mesh.max_faces"] == {
        "description": "The mesh is decimated to this many faces. none: off.",
        "anyOf": [{"type": "integer", "minimum": 0}, {"type": "null"}],
        "default": None,
    }
    assert found["options"]["properties"]["seed"]["minimum"] == 0
    assert not any(name.startswith(("train.paper.", "expert.")) for name in found["settings"])


def test_metrics_count_what_happens(stack: Stack) -> None:
    stack.http.get("/healthz")
    text = stack.http.get("/metrics").text
    assert "mgsr_queue_up 1.0" in text and "mgsr_store_up 1.0" in text and "mgsr_workers 1.0" in text
    assert 'mgsr_http_requests_total{method="GET",route="/healthz",status="200"}' in text
