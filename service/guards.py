"""Guard a service without keys: only programs of this machine may use it, not web pages of other sites."""

from __future__ import annotations

from collections.abc import Callable
from urllib.parse import urlsplit

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from service.problems import Problem

LOOPBACK_NAMES = {"localhost", "127.0.0.1", "::1"}


class LocalGuard:
    """Middleware that refuses requests to other hosts and from pages of other sites, while there are no keys.

    A request with another host comes from a web page whose name resolves to this machine (DNS rebinding).
    """

    def __init__(self, app: ASGIApp, keys_needed: Callable[[], bool | None], hosts: set[str]) -> None:
        self._app, self._keys_needed, self._hosts = app, keys_needed, hosts | LOOPBACK_NAMES

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on, or refuse it."""
        if scope["type"] == "http" and not self._keys_needed():
            headers = Headers(scope=scope)
            host, origin = _name(headers.get("host", "")), headers.get("origin")
            if host not in self._hosts:
                await _refuse("host_refused", f"a service without keys answers only requests to {_list(self._hosts)}")(
                    scope, receive, send
                )
                return
            if origin is not None and (_name(urlsplit(origin).netloc) not in self._hosts):
                await _refuse("origin_refused", "a service without keys refuses requests from pages of other sites")(
                    scope, receive, send
                )
                return
        await self._app(scope, receive, send)


def _refuse(code: str, detail: str) -> ASGIApp:
    return Problem(403, code, detail).response()


def _name(address: str) -> str:
    """Return the host's name without its port, or an empty string for an invalid address."""
    try:
        return urlsplit(f"//{address}").hostname or ""
    except ValueError:
        return ""


def _list(names: set[str]) -> str:
    return ", ".join(sorted(names))
