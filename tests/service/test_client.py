"""The client against servers that misbehave."""

from __future__ import annotations

import hashlib
import re
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest

from service.client.api import Client, DamagedDownload

DATA = bytes(range(256)) * 4096
ARTIFACT = {"name": "mesh.ply", "size": len(DATA), "sha256": hashlib.sha256(DATA).hexdigest()}


class Fickle:
    """Sends a file of which each answer holds at most `most` bytes; then the connection ends.

    ranges: whether it sends parts. Another address redirects to the first, as S3 does.
    """

    def __init__(self) -> None:
        self.most, self.ranges, self.data = len(DATA), True, DATA
        self.asked: list[tuple[str, str | None, str | None]] = []
        fickle = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                wanted = self.headers.get("Range")
                fickle.asked.append((self.path, wanted, self.headers.get("Authorization")))
                if self.path.endswith("/artifacts/moved.ply"):
                    self.send_response(307)
                    self.send_header("Location", f"{fickle.url}/bucket/mesh.ply?signed=1")
                    self.send_header("Content-Length", "0")
                    self.end_headers()
                    return
                begin = int(re.findall(r"\d+", wanted)[0]) if wanted and fickle.ranges else 0
                rest = fickle.data[begin:]
                self.send_response(206 if begin else 200)
                self.send_header("Content-Length", str(len(rest)))
                self.end_headers()
                self.wfile.write(rest[: fickle.most])

            def log_message(self, format: str, *arguments: Any) -> None:
                """Log nothing."""

        self.server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self.server.server_port}"
        threading.Thread(target=self.server.serve_forever, daemon=True).start()


@pytest.fixture
def fickle() -> Iterator[Fickle]:
    made = Fickle()
    yield made
    made.server.shutdown()
    made.server.server_close()


def download(fickle: Fickle, folder: Path, name: str = "mesh.ply") -> int:
    """Download a file, and return the sum of the reported sizes."""
    reported: list[int] = []
    with Client(fickle.url, "mgsr_key") as client:
        client.download("1", ARTIFACT | {"name": name}, folder / "out/mesh.ply", reported.append)
    return sum(reported)


@pytest.mark.parametrize("name", ["mesh.ply", "moved.ply"])
def test_a_download_that_is_cut_goes_on_where_it_was(fickle: Fickle, tmp_path: Path, name: str) -> None:
    fickle.most = len(DATA) // 2 + 1
    assert download(fickle, tmp_path, name) == len(DATA)
    assert (tmp_path / "out/mesh.ply").read_bytes() == DATA
    sent = [(wanted, key) for path, wanted, key in fickle.asked if "moved" not in path]
    assert [wanted for wanted, _ in sent] == [None, f"bytes={fickle.most}-"]
    assert {key for _, key in sent} == ({"Bearer mgsr_key"} if name == "mesh.ply" else {None}), "the key is not for S3"


def test_a_server_without_ranges_sends_it_again(fickle: Fickle, tmp_path: Path) -> None:
    fickle.ranges, fickle.most = False, len(DATA) - 1
    threading.Timer(0.2, lambda: setattr(fickle, "most", len(DATA))).start()
    assert download(fickle, tmp_path) == len(DATA)
    assert (tmp_path / "out/mesh.ply").read_bytes() == DATA


def test_what_comes_damaged_is_not_kept_for_good(fickle: Fickle, tmp_path: Path) -> None:
    fickle.data = DATA[:-1] + b"?"
    with pytest.raises(DamagedDownload, match="damaged"):
        download(fickle, tmp_path)
    assert not (tmp_path / "out/mesh.ply").exists()
