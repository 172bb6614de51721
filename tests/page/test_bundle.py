"""The page's files: built from their sources, sent with the right headers, without a browser."""

from __future__ import annotations

import gzip
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from fastapi.testclient import TestClient

from service.app import create_app
from service.contract.settings import Settings

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "service" / "page"
# Codes that no person's browser gets to see: webhooks and ranges are not the page's.
CODE = re.compile(r"""(?:Problem\(\s*\d+,\s*|code=|_failed\(\s*|_unavailable\(|_refuse\(\s*)"([a-z_]+)\"""")


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> TestClient:
    """Provide a client of the app without a queue: the page needs none."""
    folder = tmp_path_factory.mktemp("bundle")
    app = create_app(Settings(redis_url="redis://127.0.0.1:1", store=str(folder)))
    return TestClient(app, base_url="http://127.0.0.1")


@pytest.mark.slow
def test_the_committed_bundle_is_what_the_sources_give() -> None:
    """Check the bundle and the types, as `make page-check` does, which also installs what it needs."""
    if shutil.which("npm") is None or not (PAGE / "node_modules").is_dir():
        pytest.skip("the bundle is not checked: no npm, or no node_modules (run `make page-check`)")
    ran = subprocess.run(["npm", "run", "--silent", "check"], cwd=PAGE, capture_output=True, text=True, timeout=200)
    assert ran.returncode == 0, ran.stdout + ran.stderr


def test_the_page_names_only_files_that_are_there(client: TestClient) -> None:
    page = client.get("/")
    assert page.status_code == 200 and page.headers["content-type"].startswith("text/html")
    names = re.findall(r'(?:src|href)="(/page/[^"]+)"', page.text)
    assert len(names) >= 4
    for name in names:
        assert client.get(name).status_code == 200, name


def test_nothing_inline_and_no_other_host(client: TestClient) -> None:
    page = client.get("/")
    policy = dict(part.strip().partition(" ")[::2] for part in page.headers["content-security-policy"].split(";"))
    assert policy["default-src"] == "'none'" and policy["frame-ancestors"] == "'none'"
    assert policy["script-src"] == "'self' 'wasm-unsafe-eval'" and policy["connect-src"] == "'self'"
    assert "unsafe-inline" not in page.headers["content-security-policy"]
    assert not re.search(r"<script(?![^>]*src=)|<style|\son\w+=|\sstyle=|https?://", page.text)


def test_hashed_files_are_kept_and_the_page_is_asked_for(client: TestClient) -> None:
    page = client.get("/")
    script = re.search(r"/page/main-\w+\.js", page.text)
    assert script is not None
    assert "immutable" in client.get(script[0]).headers["cache-control"]
    assert page.headers["cache-control"] == "no-cache"
    again = client.get("/", headers={"If-None-Match": page.headers["etag"]})
    assert again.status_code == 304 and again.content == b""


def test_large_files_are_packed_for_who_takes_it(client: TestClient) -> None:
    (viewer,) = (PAGE / "built").glob("viewer-*.js")
    for wanted in ("gzip", "identity"):
        with client.stream("GET", f"/page/{viewer.name}", headers={"Accept-Encoding": wanted}) as answer:
            raw = b"".join(answer.iter_raw())
        packed = answer.headers.get("content-encoding") == "gzip"
        assert packed == (wanted == "gzip")
        assert (gzip.decompress(raw) if packed else raw) == viewer.read_bytes()


def test_what_is_no_file_of_the_page_is_a_problem(client: TestClient) -> None:
    for name in ("main.js", "..%2f..%2fapp.py", ""):
        answer = client.get(f"/page/{name}")
        assert answer.status_code == 404 and answer.json()["code"] == "not_found"


def test_licences_of_all_that_is_bundled(client: TestClient) -> None:
    text = client.get("/page/NOTICES.txt").text
    for name in ("three 0.183.2 (MIT)", "@sparkjsdev/spark 2.2.0 (MIT)", "fflate", "tus-js-client 4.3.1 (MIT)"):
        assert name in text
    assert text.count("Permission is hereby granted") == 7 and text.count("Redistributions in binary form") == 1


def test_every_error_has_words() -> None:
    """Check that the page knows every code in the Python sources."""
    sources = [*(ROOT / "service").rglob("*.py"), *(ROOT / "worker").rglob("*.py")]
    said = {code for path in sources for code in CODE.findall(path.read_text(encoding="utf-8"))}
    documented = re.findall(r"^\| (`[a-z_`, ]+`) \|", (ROOT / "docs/service.md").read_text(encoding="utf-8"), re.M)
    said |= {code for row in documented for code in re.findall(r"[a-z_]+", row)}
    words = (PAGE / "src/parts/words.ts").read_text(encoding="utf-8")
    known = set(re.findall(r'^  ([a-z_]+): "', words, re.M))
    assert len(said) > 40 and said - known - {"not_found", "method_not_allowed", "refused"} == set()
