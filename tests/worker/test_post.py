"""Webhooks: signed, retried, delivered whatever dies, and never sent to forbidden addresses."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError
from standardwebhooks.webhooks import Webhook, WebhookVerificationError

from service.contract.jobs import Jobs
from service.contract.options import JobOptions
from service.contract.records import JobRecord, now
from service.contract.store import Store
from service.contract.webhooks import is_public, names_private_host
from tests.service.stack import Stack
from tests.worker.archives import zip_of
from worker.post import Post


class Receiver:
    """An HTTP server that keeps what comes, and answers with the next of `answers`; 204 once they are used up."""

    def __init__(self) -> None:
        self.answers: list[int] = []
        self.came: list[tuple[dict[str, str], bytes]] = []
        self.arrived = threading.Event()
        receiver = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                body = self.rfile.read(int(self.headers["Content-Length"]))
                receiver.came.append((dict(self.headers.items()), body))
                status = receiver.answers.pop(0) if receiver.answers else 204
                self.send_response(status)
                self.send_header("Location", "/elsewhere")
                self.end_headers()
                if status == 204:
                    receiver.arrived.set()

            def log_message(self, format: str, *arguments: Any) -> None:
                """Log nothing: the tests look at what came."""

        self.server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://localhost:{self.server.server_port}/hook?token=1"
        threading.Thread(target=self.server.serve_forever, daemon=True).start()


@pytest.fixture
def receiver() -> Iterator[Receiver]:
    made = Receiver()
    yield made
    made.server.shutdown()
    made.server.server_close()


@pytest.fixture(scope="module")
def calling(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    """Yield a service that may call this machine."""
    with Stack(tmp_path_factory.mktemp("calling"), MGSR_WEBHOOK_PRIVATE="1") as running:
        yield running


@pytest.mark.slow
def test_the_end_of_a_job_is_told_and_signed(calling: Stack, receiver: Receiver) -> None:
    """Check the signature by Standard Webhooks' own library; the receiver fails at first."""
    receiver.answers = [500, 302]
    answer = calling.submit(zip_of(("readme.txt", b"nothing")), {"webhook": receiver.url, "name": "empty"})
    assert receiver.arrived.wait(90), calling.logs()
    assert len(receiver.came) == 3
    secret = calling.http.get("/webhook-secret").json()["secret"]
    headers, body = receiver.came[-1]
    reported = Webhook(secret).verify(body, headers)
    job = calling.job(answer.json()["id"])
    assert reported["type"] == "job.failed"
    assert reported["data"]["id"] == job["id"] and reported["data"]["name"] == "empty"
    assert reported["data"]["error"] == job["error"] and job["error"]["code"] == "bad_scene"
    assert len({headers["webhook-id"] for headers, _ in receiver.came}) == 1
    with pytest.raises(WebhookVerificationError):
        Webhook(secret).verify(body.replace(b"failed", b"gained"), headers)


def ended(store: Store, url: str) -> Jobs:
    """Return the jobs of a store with one of another worker that has just been cancelled."""
    jobs = Jobs(store)
    options = JobOptions(webhook=url)
    jobs.create(
        JobRecord(
            id="0" * 32, owner="a", created=now(), options=options, archive="a", archive_bytes=0, payload_sha256=""
        )
    )
    jobs.cancel_now("0" * 32, 0)
    return jobs


def test_each_end_is_told_once_by_one_of_many(calling: Stack, receiver: Receiver, tmp_path: Path) -> None:
    calling.redis.flushall()
    jobs = ended(Store(str(tmp_path), 1.0), receiver.url)
    workers = [Post(jobs, calling.redis, allow_private=True) for _ in range(4)]
    threads = [threading.Thread(target=post.look) for post in workers]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(receiver.came) == 1 and json.loads(receiver.came[0][1])["type"] == "job.cancelled"
    assert jobs.untold_rounds() == []


def test_a_receiver_that_is_gone_is_left_alone(calling: Stack, receiver: Receiver, tmp_path: Path) -> None:
    calling.redis.flushall()
    receiver.answers = [410]
    jobs = ended(Store(str(tmp_path), 1.0), receiver.url)
    Post(jobs, calling.redis, allow_private=True).look()
    assert jobs.untold_rounds() == [] and len(receiver.came) == 1


def test_a_job_that_is_removed_has_no_more_to_tell(tmp_path: Path) -> None:
    jobs = ended(Store(str(tmp_path), 1.0), "http://receiver.example/")
    record = jobs.record("0" * 32)
    assert record is not None and jobs.untold_rounds() == [(record.id, 0)]
    jobs.remove(record)
    assert jobs.untold_rounds() == [] and not [path for path in tmp_path.rglob("*") if path.is_file()]


def test_a_private_address_is_not_called(calling: Stack, receiver: Receiver, tmp_path: Path) -> None:
    """Check that the address that a name has at the call decides, whatever it was at the submit."""
    calling.redis.flushall()
    jobs = ended(Store(str(tmp_path), 1.0), receiver.url.replace("localhost", "127.1"))
    Post(jobs, calling.redis, allow_private=False).look()
    assert not receiver.came and jobs.untold_rounds() == [("0" * 32, 0)]


@pytest.mark.parametrize(
    "url",
    ["http://localhost:1/", "http://127.0.0.1/", "http://[::1]/", "http://169.254.169.254/latest", "https://10.0.0.1"],
)
def test_a_submit_with_a_private_address_is_refused(stack: Stack, url: str) -> None:
    answer = stack.submit(zip_of(("readme.txt", b"nothing")), {"webhook": url})
    assert answer.status_code == 422 and answer.json()["code"] == "webhook_refused"


@pytest.mark.parametrize(
    "address",
    [
        *("127.0.0.1", "10.1.2.3", "192.168.0.1", "169.254.169.254", "100.64.0.1", "0.0.0.0", "224.0.0.1", "::", "::1"),
        *("fe80::1%eth0", "fd00::1", "::ffff:127.0.0.1", "64:ff9b::7f00:1", "2002:7f00:1::", "ff02::1"),
    ],
)
def test_addresses_that_are_private(address: str) -> None:
    assert not is_public(address)
    assert names_private_host(f"http://[{address}]/" if ":" in address else f"http://{address}/")


@pytest.mark.parametrize("address", ["1.1.1.1", "2606:4700:4700::1111", "::ffff:1.1.1.1"])
def test_addresses_that_are_public(address: str) -> None:
    assert is_public(address)


@pytest.mark.parametrize(
    "url",
    ["ftp://host/", "http://", "http:///path", "http://user:word@host/", "http://host:99999/", "http://[::1/", "x"],
)
def test_what_is_no_address(url: str) -> None:
    with pytest.raises(ValidationError):
        JobOptions(webhook=url)
