"""Keys and owners; and what a service without keys refuses."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from typer.testing import CliRunner, Result

from program.__main__ import app
from service.contract.settings import Settings
from service.contract.store import Store
from service.keys import Keys
from tests.service.stack import ROOT, TINY_OPTIONS, Stack


@pytest.fixture(scope="module")
def keyed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Stack, str, str]]:
    """Yield a service with two keys, and no worker."""
    folder = tmp_path_factory.mktemp("keyed")
    keys = [program(folder, "keys", "create", name).stdout.strip() for name in ("anna", "bert")]
    with Stack(folder, workers=0) as running:
        yield running, keys[0], keys[1]


def program(home: Path, *arguments: str) -> Result:
    """Run `mgsr` on a folder of its own."""
    return CliRunner().invoke(app, arguments, env={"MGSR_HOME": str(home)})


def bearer(key: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {key}"}


def test_without_a_key_nothing_is_told(keyed: tuple[Stack, str, str]) -> None:
    stack, anna, _ = keyed
    for method, address in (("GET", "/jobs"), ("POST", "/jobs"), ("GET", "/jobs/" + "0" * 32), ("GET", "/options")):
        for headers in ({}, bearer("mgsr_wrong"), {"Authorization": f"Basic {anna}"}):
            answer = stack.http.request(method, address, headers=headers)
            assert answer.status_code == 401 and answer.json()["code"] == "key_unknown"
            assert answer.headers["WWW-Authenticate"] == "Bearer"
    assert stack.http.get("/healthz").status_code == 200


def test_a_job_of_another_owner_does_not_exist(keyed: tuple[Stack, str, str], tiny_archive: bytes) -> None:
    stack, anna, bert = keyed
    job = stack.submit(tiny_archive, TINY_OPTIONS, **bearer(anna)).json()["id"]
    assert stack.http.get(f"/jobs/{job}", headers=bearer(anna)).status_code == 200
    unknown = stack.http.get("/jobs/" + "0" * 32, headers=bearer(bert))
    for method, path in (
        *(
            ("GET", ""),
            ("DELETE", ""),
            ("DELETE", "/data"),
            ("POST", "/retry"),
            ("POST", "/rerun"),
            ("GET", "/events"),
            ("GET", "/mesh.ply"),
        ),
        *(("GET", "/artifacts"), ("GET", "/log.txt"), ("GET", "/previews/render.webp")),
    ):
        answer = stack.http.request(method, f"/jobs/{job}{path}", headers=bearer(bert))
        assert answer.status_code == 404 and answer.json()["code"] == "job_unknown"
        assert answer.json()["title"] == unknown.json()["title"]
    assert [listed["id"] for listed in stack.http.get("/jobs", headers=bearer(anna)).json()["jobs"]] == [job]
    assert stack.http.get("/jobs", headers=bearer(bert)).json()["jobs"] == []
    same_key = {"Idempotency-Key": "shared"}
    ids = {stack.submit(tiny_archive, TINY_OPTIONS, **bearer(k), **same_key).json()["id"] for k in (anna, bert)}
    assert len(ids) == 2


def test_the_store_has_no_key(keyed: tuple[Stack, str, str]) -> None:
    stack, anna, _ = keyed
    files = [path for path in (stack.folder / "store").rglob("*") if path.is_file()]
    assert not any(anna.encode() in path.read_bytes() or anna in path.name for path in files)


def test_a_revoked_key_opens_nothing_and_leaves_nothing_open(tmp_path: Path) -> None:
    keys = Keys(Store(str(tmp_path), 1.0))
    token, key = keys.create("anna")
    seen = Keys(Store(str(tmp_path), 1.0))
    assert seen.needed() and seen.find(token) == key
    assert keys.revoke(key.id) and not keys.revoke(key.id)
    assert Keys(Store(str(tmp_path), 1.0)).find(token) is None
    assert seen.needed()  # for as long as that service runs
    assert not Keys(Store(str(tmp_path), 1.0)).needed()


def test_the_commands_of_keys(tmp_path: Path) -> None:
    made = program(tmp_path, "keys", "create", "anna")
    assert made.exit_code == 0 and made.stdout.startswith("mgsr_")
    listed = program(tmp_path, "keys", "list").stdout
    assert "anna" in listed and made.stdout.strip() not in listed
    assert program(tmp_path, "keys", "revoke", listed.split()[0]).exit_code == 0
    assert program(tmp_path, "keys", "list").stdout == ""
    assert program(tmp_path, "keys", "revoke", "nobody").exit_code == 2


def test_without_keys_only_this_machine_is_served(stack: Stack) -> None:
    command = [sys.executable, "-m", "service.cli", "--host", "0.0.0.0", "--port", str(stack.port + 1)]
    ran = subprocess.run(command, env=stack.environment, capture_output=True, text=True, cwd=ROOT, timeout=60)
    assert ran.returncode == 2 and "mgsr keys create" in ran.stderr


@pytest.mark.parametrize(
    ("headers", "code"),
    [
        ({"Host": "evil.example"}, "host_refused"),
        ({"Origin": "https://evil.example"}, "origin_refused"),
        ({"Origin": "null"}, "origin_refused"),
    ],
)
def test_without_keys_pages_of_other_sites_are_refused(stack: Stack, headers: dict[str, str], code: str) -> None:
    answer = httpx.get(f"{stack.url}/jobs", headers=headers)
    assert answer.status_code == 403 and answer.json()["code"] == code


def test_the_settings_say_what_is_wrong(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MGSR_MAX_UPLOAD", "3GiB")
    assert Settings().max_upload == 3 << 30
    environment = os.environ | {"MGSR_MAX_UPLOAD": "many", "PYTHONPATH": str(ROOT)}
    ran = subprocess.run(
        [sys.executable, "-m", "service.cli"], env=environment, capture_output=True, text=True, cwd=ROOT, timeout=60
    )
    assert ran.returncode == 2 and "MGSR_MAX_UPLOAD" in ran.stderr
