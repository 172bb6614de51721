"""/healthz, /readyz, /metrics: for operators of the service."""

from __future__ import annotations

from fastapi import APIRouter, Response
from fastapi.concurrency import run_in_threadpool
from pydantic import BaseModel
from redis import RedisError

from service.contract.errors import StoreError
from service.parts import Parts, PartsDep
from service.problems import Problem, answers

router = APIRouter(tags=["health"])


class Health(BaseModel):
    """status: ok."""

    status: str = "ok"


class Readiness(Health):
    """The readiness of the service. workers: the number of workers. Without workers, jobs are accepted and wait."""

    workers: int


@router.get("/healthz")
async def healthz() -> Health:
    """Check that this process answers."""
    return Health()


@router.get("/readyz", responses={503: answers(503)[503]})
async def readyz(parts: PartsDep) -> Readiness:
    """Check that store and queue answer."""
    return Readiness(workers=await run_in_threadpool(_check, parts))


@router.get("/metrics", response_class=Response, responses={200: {"content": {"text/plain": {}}}})
async def metrics(parts: PartsDep) -> Response:
    """Get metrics for Prometheus."""
    data, kind = await run_in_threadpool(parts.metrics.render)
    return Response(data, headers={"Content-Type": kind})


def _check(parts: Parts) -> int:
    try:
        parts.jobs.store.check()
    except StoreError as error:
        raise Problem(503, "store_unavailable", str(error)) from error
    try:
        return parts.queue.workers()
    except RedisError as error:
        raise Problem(503, "queue_unavailable", str(error)) from error
