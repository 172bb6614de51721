"""The HTTP protocol of the API's server."""

from __future__ import annotations

import asyncio

from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

LOOK_AGAIN = 0.02  # seconds
WAIT_AT_MOST = 5.0  # seconds; an application that has not read by then does not want the bytes


class PatientProtocol(HttpToolsProtocol):
    """uvicorn's protocol, changed to deliver all bytes of a request that arrive before its connection breaks.

    After a disconnect, uvicorn itself drops the bytes that the application has not read yet. These are up to 64 KiB
    (`uvicorn.protocols.http.flow_control`), and the bytes read from the socket with them. A resumable upload needs
    them.
    """

    def connection_lost(self, exc: Exception | None) -> None:
        """Tell the application of the broken connection once it has read all received bytes."""
        self._tell_when_read(exc, WAIT_AT_MOST)

    def _tell_when_read(self, exc: Exception | None, left: float) -> None:
        cycle = self.cycle
        if left > 0 and cycle is not None and not cycle.response_complete and cycle.body:
            asyncio.get_running_loop().call_later(LOOK_AGAIN, self._tell_when_read, exc, left - LOOK_AGAIN)
        else:
            super().connection_lost(exc)
