"""Errors as RFC 9457 problem details with a stable code for programs."""

from __future__ import annotations

from http import HTTPStatus
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse, Response
from pydantic import BaseModel, ConfigDict, Field
from redis import RedisError
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect

from service.contract.errors import StoreError

MEDIA_TYPE = "application/problem+json"


class ProblemDetails(BaseModel):
    """An error in the form of RFC 9457."""

    model_config = ConfigDict(
        extra="allow",
        json_schema_extra={
            "example": {
                "type": "urn:mgsr:problem:job_unknown",
                "title": "Not Found",
                "status": 404,
                "code": "job_unknown",
                "detail": "you have no job 5f0c; GET /jobs lists your jobs",
            }
        },
    )

    type: str
    title: str
    status: int
    code: str = Field(description="A stable code for programs.")
    detail: str = Field(description="A sentence for people: what was expected, what came, and the remedy.")


class Problem(Exception):
    """An error that becomes the answer to a request."""

    def __init__(self, status: int, code: str, detail: str, headers: dict[str, str] | None = None, **more: Any) -> None:
        super().__init__(detail)
        self.status, self.code, self.detail, self.headers, self.more = status, code, detail, headers or {}, more

    def response(self) -> Response:
        """Return the problem as a JSON response."""
        body = ProblemDetails(
            type=f"urn:mgsr:problem:{self.code}",
            title=_title(self.status),
            status=self.status,
            code=self.code,
            detail=self.detail,
            **self.more,
        )
        return JSONResponse(body.model_dump(), self.status, self.headers, MEDIA_TYPE)


def answers(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """Return the documentation of a route's errors: these, and 400, 401, 403 and 503, which every route may return."""
    reference = {"schema": {"$ref": "#/components/schemas/ProblemDetails"}}
    return {
        status: {"description": _title(status), "content": {MEDIA_TYPE: reference}}
        for status in sorted({400, 401, 403, 503, *statuses})
    }


def _title(status: int) -> str:
    """Return the status in words. A status that HTTP does not define gets the words of its class."""
    try:
        return HTTPStatus(status).phrase
    except ValueError:
        return HTTPStatus(status // 100 * 100).phrase


def install(app: FastAPI) -> None:
    """Make the app answer every error as a problem."""
    app.add_exception_handler(Problem, _problem)
    app.add_exception_handler(HTTPException, _http)
    app.add_exception_handler(RequestValidationError, _invalid)
    app.add_exception_handler(StoreError, _store)
    app.add_exception_handler(RedisError, _redis)
    app.add_exception_handler(ClientDisconnect, _gone)


async def _problem(request: Request, error: Exception) -> Response:
    assert isinstance(error, Problem)
    return error.response()


async def _http(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    code = {404: "not_found", 405: "method_not_allowed"}.get(error.status_code, "refused")
    return Problem(error.status_code, code, str(error.detail), dict(error.headers or {})).response()


async def _invalid(request: Request, error: Exception) -> Response:
    assert isinstance(error, RequestValidationError)
    found = [f"{'.'.join(str(part) for part in item['loc'])}: {item['msg']}" for item in error.errors()]
    return Problem(422, "bad_request", "; ".join(found)).response()


async def _store(request: Request, error: Exception) -> Response:
    return _unavailable("store_unavailable", f"the artifact store does not answer; try again soon ({error})")


async def _redis(request: Request, error: Exception) -> Response:
    return _unavailable("queue_unavailable", f"the server of the queue does not answer; try again soon ({error})")


async def _gone(request: Request, error: Exception) -> Response:
    """Return a problem that only the metrics count, since the client has disconnected."""
    return Problem(400, "upload_cut", "the connection closed before the request was complete").response()


def _unavailable(code: str, detail: str) -> Response:
    return Problem(503, code, detail, {"Retry-After": "5"}).response()
