"""A client that breaks the rules: raw sockets, so that tests control every byte and pause."""

from __future__ import annotations

import json
import socket
import time
from dataclasses import dataclass
from typing import Any


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
