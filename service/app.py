"""Assemble the service's FastAPI app."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from typing import TYPE_CHECKING

from fastapi import FastAPI
from fastapi.concurrency import run_in_threadpool
from redis import RedisError
from redis.asyncio import Redis as AsyncRedis

from service.contract.errors import StoreError
from service.contract.jobs import Jobs
from service.contract.live import Live
from service.contract.options import LIBRARY
from service.contract.queue import JobQueue, connect
from service.contract.recovery import PERIOD, Recovery
from service.contract.resumable import ResumableUploads
from service.contract.settings import Settings
from service.contract.store import Store
from service.events import EventHub
from service.guards import LocalGuard
from service.housekeeping import Housekeeping
from service.keys import Keys
from service.metrics import Metrics, MetricsMiddleware
from service.openapi import describe
from service.parts import Parts
from service.polls import Polls
from service.problems import install
from service.routes import artifacts, health, jobs, options, page, uploads, webhooks
from service.snapshots import Snapshots

if TYPE_CHECKING:
    from opentelemetry.sdk.trace import TracerProvider

log = logging.getLogger("mgsr.service")

# The seconds for which a request waits for a store that doesn't answer.
STORE_PATIENCE = 4.0


def create_app(settings: Settings, telemetry: TracerProvider | None = None) -> FastAPI:
    """Create the service's app. telemetry: the tracer provider for the spans of its requests.

    Raises SetupError if no Redis server is named, and StoreError if the store can't be opened.
    """
    parts = _make_parts(settings)
    app = FastAPI(
        title="MGSR",
        version=LIBRARY["version"],
        description="Turn photographs into a surface mesh and clean renders.",
        lifespan=_lifespan,
    )
    app.state.parts = parts
    install(app)
    for routes in (jobs, uploads, artifacts, options, webhooks, health, page):
        app.include_router(routes.router)
    # The middleware added last runs first: the guard, then the metrics, the polls and the routes.
    polled = next(route for route in jobs.router.routes if getattr(route, "endpoint", None) is jobs.get_job)
    app.add_middleware(Polls, keys=parts.keys, snapshots=parts.snapshots, route=polled)
    app.add_middleware(MetricsMiddleware, metrics=parts.metrics)
    hosts = {name.strip().lower() for name in settings.allowed_hosts.split(",") if name.strip()}
    app.add_middleware(LocalGuard, keys_needed=lambda: parts.keys.needed_cached, hosts=hosts)
    describe(app)
    if telemetry is not None:
        from opentelemetry.instrumentation.fastapi import FastAPIInstrumentor

        FastAPIInstrumentor.instrument_app(app, tracer_provider=telemetry, excluded_urls="healthz,readyz,metrics")
    return app


def _make_parts(settings: Settings) -> Parts:
    url = settings.need_redis()
    redis, store = connect(url), Store(settings.store_url, STORE_PATIENCE)
    async_redis = AsyncRedis.from_url(url, socket_timeout=5.0, socket_connect_timeout=2.0)
    jobs, queue = Jobs(store), JobQueue(redis)
    snapshots = Snapshots(jobs, queue, async_redis, settings.retention)
    return Parts(
        settings=settings,
        jobs=jobs,
        uploads=ResumableUploads(store, settings.upload_lifetime),
        keys=Keys(store),
        live=Live(redis),
        queue=queue,
        redis=async_redis,
        snapshots=snapshots,
        hub=EventHub(async_redis, snapshots),
        metrics=Metrics(jobs, queue),
    )


@asynccontextmanager
async def _lifespan(app: FastAPI) -> AsyncIterator[None]:
    parts: Parts = app.state.parts
    recovering = asyncio.create_task(_recover(parts))
    yield
    recovering.cancel()
    with suppress(asyncio.CancelledError):
        await recovering
    await parts.redis.aclose()


async def _recover(parts: Parts) -> None:
    """Recover lost jobs, as workers do, and remove expired data.

    Without a worker, the service itself must notice that a job was cancelled.
    """
    recovery = Recovery(parts.jobs, parts.live, parts.queue)
    housekeeping = Housekeeping(parts.jobs, parts.live, parts.uploads, parts.settings.retention)
    while True:
        try:
            await run_in_threadpool(parts.keys.needed)
            await run_in_threadpool(recovery.look)
            await run_in_threadpool(housekeeping.look)
        except (RedisError, StoreError) as error:
            log.warning("recovery failed and will be retried: %s", error)
        await asyncio.sleep(PERIOD)
