"""The web page: / and its files, which are built from service/page/src."""

from __future__ import annotations

import gzip
import hashlib
import mimetypes
import re
from dataclasses import dataclass
from functools import cached_property
from importlib.resources import files
from typing import Annotated

from fastapi import APIRouter, Header, Path, Response

from service.problems import Problem

router = APIRouter(include_in_schema=False)

# Names with a hash of the content; see service/page/build.mjs.
_HASHED = re.compile(r".+-[A-Z0-9]{8}\.(js|css)")
_TYPES = {".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml"}
_SMALL = 1024  # bytes, below which compression gains nothing

# Everything comes from this service, and the page has no inline scripts. Spark, which draws the splats, needs two
# exceptions: its decoder is WebAssembly ('wasm-unsafe-eval'; eval stays forbidden), and runs in a worker from a blob.
# Pictures also come from blobs, because <img> can't send a key.
PAGE_POLICY = (
    "default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; style-src 'self'; img-src 'self' blob:; "
    "connect-src 'self'; worker-src blob:; frame-src 'self'; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'"
)
# A report is one file with inline style, script and pictures. These are allowed, but no origin and no connections.
REPORT_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:; base-uri 'none'; "
    "form-action 'none'; frame-ancestors 'self'; sandbox allow-scripts"
)


@dataclass(frozen=True)
class PageFile:
    """A file of the page."""

    name: str
    data: bytes

    @property
    def kind(self) -> str:
        """Return its media type."""
        ending = "." + self.name.rpartition(".")[2]
        return _TYPES.get(ending) or mimetypes.guess_type(self.name)[0] or "application/octet-stream"

    @cached_property
    def etag(self) -> str:
        """Return its entity tag, a hash of the content."""
        return f'"{hashlib.sha256(self.data).hexdigest()[:32]}"'

    @cached_property
    def packed(self) -> bytes:
        """Return the content as gzip."""
        return gzip.compress(self.data, 6, mtime=0)

    def headers(self) -> dict[str, str]:
        """Return its response headers."""
        policy = REPORT_POLICY if self.name == "report.html" else PAGE_POLICY
        return {
            "Cache-Control": "public, max-age=31536000, immutable" if _HASHED.fullmatch(self.name) else "no-cache",
            "Content-Security-Policy": policy,
            "ETag": self.etag,
            "Referrer-Policy": "no-referrer",
            "Vary": "Accept-Encoding",
            "X-Content-Type-Options": "nosniff",
        }


def _read_files() -> dict[str, PageFile]:
    """Read every file of the page, by its name. There are none if the page was not built."""
    folder = files("service") / "page" / "built"
    return {item.name: PageFile(item.name, item.read_bytes()) for item in folder.iterdir()} if folder.is_dir() else {}


_FILES = _read_files()

AcceptEncoding = Annotated[str, Header(max_length=1000)]
IfNoneMatch = Annotated[str | None, Header(max_length=1000)]


@router.get("/")
def get_page(accept_encoding: AcceptEncoding = "", if_none_match: IfNoneMatch = None) -> Response:
    """Get the page."""
    return _send("index.html", accept_encoding, if_none_match)


@router.get("/page/{name}")
def get_page_file(
    name: Annotated[str, Path(max_length=100)], accept_encoding: AcceptEncoding = "", if_none_match: IfNoneMatch = None
) -> Response:
    """Get one of the page's files."""
    return _send(name, accept_encoding, if_none_match)


def _send(name: str, accept_encoding: str, if_none_match: str | None) -> Response:
    file = _FILES.get(name)
    if file is None:
        raise Problem(404, "not_found", f"the web page has no file {name!r}")
    headers = file.headers()
    if if_none_match is not None and file.etag in if_none_match:
        return Response(status_code=304, headers=headers)
    if "gzip" in accept_encoding and len(file.data) > _SMALL:
        return Response(file.packed, headers=headers | {"Content-Encoding": "gzip"}, media_type=file.kind)
    return Response(file.data, headers=headers, media_type=file.kind)
