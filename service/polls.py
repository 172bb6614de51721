"""A shortcut before the routes for `GET /jobs/{id}`, which clients poll.

Without it, FastAPI's own work for three hundred clients that poll once a second would take a third of a core. This
module answers only from memory: caller and job must have been looked up recently. All other requests go on to the
route, which gives the same answer (`poll_answer`).
"""

from __future__ import annotations

from starlette.datastructures import Headers
from starlette.responses import Response
from starlette.types import ASGIApp, Receive, Scope, Send

from service.keys import Keys
from service.parts import LOCAL
from service.snapshots import Snapshot, Snapshots

_PREFIX = "/jobs/"


class Polls:
    """Middleware that answers polls before the routes. route: the route under which metrics count them."""

    def __init__(self, app: ASGIApp, keys: Keys, snapshots: Snapshots, route: object) -> None:
        self._app, self._keys, self._snapshots, self._route = app, keys, snapshots, route

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer the request, or pass it on."""
        if scope["type"] == "http" and scope["method"] == "GET" and scope["path"].startswith(_PREFIX):
            snapshot = self._snapshots.fresh(scope["path"].removeprefix(_PREFIX))
            headers = Headers(scope=scope)
            if snapshot is not None and snapshot.owner == self._caller(headers):
                scope["route"] = self._route
                await poll_answer(snapshot, headers.get("if-none-match"))(scope, receive, send)
                return
        await self._app(scope, receive, send)

    def _caller(self, headers: Headers) -> str | None:
        """Return the owner who sends the request if it is cached, else None."""
        if self._keys.needed_cached is False:
            return LOCAL
        scheme, _, token = headers.get("authorization", "").partition(" ")
        key = self._keys.cached(token) if scheme.lower() == "bearer" else None
        return None if key is None else key.id


def poll_answer(snapshot: Snapshot, if_none_match: str | None) -> Response:
    """Return the job, or 304 if it is unchanged."""
    headers = {"ETag": snapshot.etag, "Cache-Control": "no-cache"}
    if if_none_match is not None and snapshot.etag in if_none_match:
        return Response(status_code=304, headers=headers)
    return Response(snapshot.body, media_type="application/json", headers=headers)
