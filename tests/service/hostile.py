"""Raw sockets, so that tests control every byte and pause: a client that breaks the rules, and a port that cuts."""

from __future__ import annotations

import json
import socket
import threading
import time
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from tests.service.stack import free_port


@dataclass(frozen=True)
class Answer:
    """An answer; status 0 where the connection ended without one."""

    status: int
    body: dict[str, Any]


class RawRequest:
    """One connection, with the head of a request sent. Use in `with`."""

    def __init__(self, port: int, *headers: str, path: str = "/jobs", method: str = "POST") -> None:
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=60)
        lines = [f"{method} {path} HTTP/1.1", f"Host: 127.0.0.1:{port}", *headers, "", ""]
        self.socket.sendall("\r\n".join(lines).encode())

    def __enter__(self) -> RawRequest:
        return self

    def __exit__(self, *trouble: object) -> None:
        self.socket.close()

    def send(self, data: bytes) -> bool:
        """Send the data, and return whether the other side still took it."""
        try:
            self.socket.sendall(data)
            return True
        except OSError:
            return False

    def trickle(self, count: int, pause: float) -> None:
        """Send single bytes until so many are sent, or the other side has had enough."""
        for _ in range(count):
            if not self.send(b"P"):
                return
            time.sleep(pause)

    def answer(self) -> Answer:
        """Return the service's answer."""
        held = b""
        try:
            while chunk := self.socket.recv(1 << 16):
                held += chunk
                head, found, body = held.partition(b"\r\n\r\n")
                if found and len(body) >= _length(head):
                    break
        except OSError:
            pass
        if not held:
            return Answer(0, {})
        head, _, body = held.partition(b"\r\n\r\n")
        return Answer(int(head.split()[1]), json.loads(body))


def _length(head: bytes) -> int:
    lines = [line.split(b":")[1] for line in head.lower().split(b"\r\n") if line.startswith(b"content-length:")]
    return int(lines[0]) if lines else 0


class Gate:
    """A port that forwards connections while it is open, and refuses and cuts them while it is closed."""

    def __init__(self, target: int) -> None:
        self.target, self.port = target, free_port()
        self.listener: socket.socket | None = None
        self.connections: set[socket.socket] = set()

    def open(self) -> None:
        """Let connections through."""
        self.listener = socket.create_server(("127.0.0.1", self.port), backlog=100)
        threading.Thread(target=self._accept, args=(self.listener,), daemon=True).start()

    def close(self) -> None:
        """Let nothing through any more."""
        assert self.listener is not None
        self.listener.shutdown(socket.SHUT_RDWR)
        self.listener.close()
        for connection in list(self.connections):
            with suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)

    def _accept(self, listener: socket.socket) -> None:
        with suppress(OSError):
            while True:
                outer, _ = listener.accept()
                inner = socket.create_connection(("127.0.0.1", self.target))
                self.connections |= {outer, inner}
                for source, sink in ((outer, inner), (inner, outer)):
                    threading.Thread(target=self._pump, args=(source, sink), daemon=True).start()

    def _pump(self, source: socket.socket, sink: socket.socket) -> None:
        with suppress(OSError):
            while data := source.recv(1 << 16):
                sink.sendall(data)
        with suppress(OSError):
            sink.shutdown(socket.SHUT_RDWR)
        self.connections.discard(source)
