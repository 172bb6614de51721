"""Notify owners by webhook that their jobs have ended, signed according to Standard Webhooks 1.0.

The store holds pending messages (`webhooks/`), so they survive the death of a worker and the loss of Redis. Redis holds
the time of each message's next try. A message may arrive twice, with the same id.
"""

from __future__ import annotations

import asyncio
import base64
import hashlib
import hmac
import json
import logging
import socket
from dataclasses import dataclass

import httpx
from redis import Redis

from service.contract.jobs import Jobs
from service.contract.records import JobRecord, Outcome, now
from service.contract.webhooks import is_public, webhook_secret

log = logging.getLogger("mgsr.worker")

TRY_SECONDS = 20.0  # for one call, from the name's lookup to the answer
# Seconds from one try to the next; the last value holds for all further tries.
BACK_OFF = (5, 30, 120, 600, 1800, 3600)
GIVEN_UP_SECONDS = 86400.0
AT_ONCE = 16  # the most simultaneous calls
_GONE = 410  # the receiver wants no more messages


@dataclass(frozen=True)
class Message:
    """A message to one owner, and its address."""

    id: str
    url: str
    secret: str
    body: bytes
    record: JobRecord
    round: int
    age: float

    def headers(self) -> dict[str, str]:
        """Return the headers of Standard Webhooks, signed with the current time."""
        sent = str(int(now().timestamp()))
        return {
            "Content-Type": "application/json",
            "User-Agent": "MGSR",
            "webhook-id": self.id,
            "webhook-timestamp": sent,
            "webhook-signature": signature(self.secret, self.id, sent, self.body),
        }


class Post:
    """The delivery of webhooks. allow_private: whether to call addresses of this machine and its network."""

    def __init__(self, jobs: Jobs, redis: Redis, allow_private: bool) -> None:
        self._jobs, self._redis, self._allow_private = jobs, redis, allow_private

    def look(self) -> None:
        """Try each due message once. Raises StoreError and redis.RedisError."""
        due = [message for job, number in self._jobs.untold_rounds() if (message := self._due(job, number)) is not None]
        if due:
            asyncio.run(self._deliver(due))

    def _due(self, job: str, number: int) -> Message | None:
        """Claim a message for one try, and return it.

        Returns None while another worker tries it or it waits, and for a job without outcome or webhook.
        """
        outcome, record = self._jobs.outcome(job, number), self._jobs.record(job)
        if outcome is None or record is None or record.options.webhook is None:
            return None
        if not self._redis.set(_wait_key(job, number), 1, nx=True, ex=round(TRY_SECONDS) + 10):
            return None
        return Message(
            id=f"msg_{job}_{number}",
            url=record.options.webhook,
            secret=webhook_secret(self._jobs.store, record.owner),
            body=json.dumps(content(record, number, outcome)).encode(),
            record=record,
            round=number,
            age=(now() - outcome.finished).total_seconds(),
        )

    async def _deliver(self, due: list[Message]) -> None:
        room = asyncio.Semaphore(AT_ONCE)

        async def one(message: Message) -> None:
            async with room:
                trouble = await call(message, self._allow_private)
                await asyncio.to_thread(self._note, message, trouble)

        await asyncio.gather(*(one(message) for message in due))

    def _note(self, message: Message, trouble: str | None) -> None:
        """Forget a message that arrived or that is given up. Otherwise set the time of the next try."""
        job, number = message.record.id, message.round
        if trouble is None or trouble == str(_GONE) or message.age > GIVEN_UP_SECONDS:
            self._jobs.mark_notified(job, number)
            self._redis.delete(_tries_key(job, number), _wait_key(job, number))
            log.info("job %s: webhook %s", job, "delivered" if trouble is None else f"given up: {trouble}")
            return
        tries = int(self._redis.incr(_tries_key(job, number)))
        self._redis.expire(_tries_key(job, number), round(GIVEN_UP_SECONDS))
        pause = BACK_OFF[min(tries, len(BACK_OFF)) - 1]
        self._redis.set(_wait_key(job, number), 1, ex=pause)
        log.warning("job %s: the webhook failed and is retried in %d s: %s", job, pause, trouble)


def content(record: JobRecord, number: int, outcome: Outcome) -> dict[str, object]:
    """Return the JSON content of a message: type, timestamp, and data with the job's outcome."""
    payload = outcome.model_dump(mode="json", include={"status", "finished", "error", "metrics"})
    return {
        "type": f"job.{outcome.status}",
        "timestamp": payload["finished"],
        "data": {"id": record.id, "name": record.options.name, "round": number, **payload},
    }


def signature(secret: str, message: str, sent: str, body: bytes) -> str:
    """Return the Standard Webhooks signature, version 1: HMAC-SHA256 over id, time and body."""
    key = base64.b64decode(secret.removeprefix("whsec_"))
    signed = f"{message}.{sent}.".encode() + body
    return "v1," + base64.b64encode(hmac.new(key, signed, hashlib.sha256).digest()).decode()


async def call(message: Message, allow_private: bool) -> str | None:
    """Send a message without following redirects. Returns None if it was accepted (2xx), else the reason."""
    try:
        async with asyncio.timeout(TRY_SECONDS):
            url = httpx.URL(message.url)
            address = await _address(url, allow_private)
            if address is None:
                return f"{url.host} is on this machine or its network (MGSR_WEBHOOK_PRIVATE)"
            headers = message.headers() | {"Host": url.netloc.decode()}
            # The call goes to the checked address, because the name may resolve to another one the next time.
            target, names = url.copy_with(host=address), {"sni_hostname": url.host}
            async with (
                httpx.AsyncClient(trust_env=False) as client,
                client.stream("POST", target, content=message.body, headers=headers, extensions=names) as answer,
            ):
                return None if answer.is_success else str(answer.status_code)
    except TimeoutError:
        return f"no answer within {TRY_SECONDS:g} s"
    except (httpx.HTTPError, httpx.InvalidURL, OSError, UnicodeError) as error:
        return f"{type(error).__name__}: {error}"


async def _address(url: httpx.URL, allow_private: bool) -> str | None:
    """Return an IP address of the host, or None if any of its addresses may not be called."""
    port = url.port or {"http": 80, "https": 443}[url.scheme]
    found = await asyncio.get_running_loop().getaddrinfo(url.host, port, type=socket.SOCK_STREAM)
    addresses = [str(entry[4][0]) for entry in found]
    return addresses[0] if allow_private or all(map(is_public, addresses)) else None


def _wait_key(job: str, number: int) -> str:
    return f"mgsr:webhook-wait:{job}.{number}"


def _tries_key(job: str, number: int) -> str:
    return f"mgsr:webhook-tries:{job}.{number}"
