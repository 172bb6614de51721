"""Prometheus metrics: counters of answered requests, and gauges of jobs and workers, read at each scrape."""

from __future__ import annotations

import time
from collections.abc import Iterable

from prometheus_client import CollectorRegistry, Counter, Histogram, generate_latest
from prometheus_client.core import GaugeMetricFamily, Metric
from prometheus_client.exposition import CONTENT_TYPE_LATEST
from redis import RedisError
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.contract.errors import StoreError
from service.contract.jobs import Jobs
from service.contract.queue import JobQueue


class Metrics:
    """The metrics of one app."""

    def __init__(self, jobs: Jobs, queue: JobQueue) -> None:
        self._registry = CollectorRegistry()
        self._registry.register(_JobCollector(jobs, queue))
        self.requests = Counter(
            "mgsr_http_requests", "Requests answered.", ["method", "route", "status"], registry=self._registry
        )
        self.seconds = Histogram(
            "mgsr_http_seconds", "Seconds to the first byte of the answer.", ["route"], registry=self._registry
        )

    def render(self) -> tuple[bytes, str]:
        """Return the metrics as text, and its media type."""
        return generate_latest(self._registry), CONTENT_TYPE_LATEST


class MetricsMiddleware:
    """Middleware that counts and times requests by their route."""

    def __init__(self, app: ASGIApp, metrics: Metrics) -> None:
        self._app, self._metrics = app, metrics

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        started_at = time.perf_counter()

        async def noting(message: Message) -> None:
            if message["type"] == "http.response.start":
                route = getattr(scope.get("route"), "path", "none")
                self._metrics.requests.labels(scope["method"], route, message["status"]).inc()
                self._metrics.seconds.labels(route).observe(time.perf_counter() - started_at)
            await send(message)

        await self._app(scope, receive, noting)


class _JobCollector:
    """A collector that queries queue and store at each scrape, and omits the gauges of one that doesn't answer."""

    def __init__(self, jobs: Jobs, queue: JobQueue) -> None:
        self._jobs, self._queue = jobs, queue

    def collect(self) -> Iterable[Metric]:
        """Yield the current gauges of queue and store."""
        try:
            workers, waiting = self._queue.workers(), self._queue.lengths()
        except RedisError:
            yield GaugeMetricFamily("mgsr_queue_up", "Whether the server of the queue answers.", value=0)
        else:
            yield GaugeMetricFamily("mgsr_queue_up", "Whether the server of the queue answers.", value=1)
            yield GaugeMetricFamily("mgsr_workers", "Number of workers that listen.", value=workers)
            lengths = GaugeMetricFamily("mgsr_jobs_queued", "Number of waiting jobs, by queue.", labels=["queue"])
            for name, length in waiting.items():
                lengths.add_metric([name], length)
            yield lengths
        try:
            opened = sum(1 for _ in self._jobs.open_rounds())
        except StoreError:
            yield GaugeMetricFamily("mgsr_store_up", "Whether the store answers.", value=0)
        else:
            yield GaugeMetricFamily("mgsr_store_up", "Whether the store answers.", value=1)
            yield GaugeMetricFamily("mgsr_jobs_open", "Number of jobs that are queued or running.", value=opened)
