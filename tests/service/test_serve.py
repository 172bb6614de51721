"""`mgsr serve` and `mgsr submit`, as a person uses them."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest
import trimesh

from tests.service.stack import LONG_OPTIONS, ROOT, TINY, free_port

# From when a job is taken up to its training: Python and torch start, the capture is read. No promise of the service.
START_SECONDS = 180.0

SET = [f"--set={key}={'none' if value is None else value}" for key, value in TINY.items()]


def run(home: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run `mgsr` to its end."""
    command = [sys.executable, "-m", "program", *arguments]
    return subprocess.run(command, env=environment(home), capture_output=True, text=True, timeout=120, cwd=ROOT)


def environment(home: Path) -> dict[str, str]:
    plain = {name: value for name, value in os.environ.items() if not name.startswith("MGSR_")}
    return plain | {"MGSR_HOME": str(home), "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}


@contextmanager
def serving(home: Path, port: int) -> Iterator[subprocess.Popen[str]]:
    """Yield the program in a session of its own, as in a terminal, once it says that it listens."""
    command = [sys.executable, "-m", "program", "serve", "--port", str(port)]
    with (home / "serve.log").open("w") as log:
        process = subprocess.Popen(
            command, env=environment(home), stdout=subprocess.PIPE, stderr=log, text=True, start_new_session=True
        )
    assert process.stdout is not None
    try:
        assert f"http://127.0.0.1:{port}" in process.stdout.readline(), (home / "serve.log").read_text()
        yield process
    finally:
        if process.poll() is None:
            process.kill()
        process.wait()
        process.stdout.close()


def descendants(home: Path) -> list[int]:
    """Return every process that has this home in its environment or command."""
    found = []
    for entry in Path("/proc").iterdir():
        try:
            if entry.name.isdigit() and int(entry.name) != os.getpid():
                known = (entry / "environ").read_bytes() + (entry / "cmdline").read_bytes()
                if str(home).encode() in known:
                    found.append(int(entry.name))
        except OSError:
            continue
    return found


def wait_until(condition: Callable[[], bool], seconds: float = 20.0) -> None:
    ends = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < ends
        time.sleep(0.1)


def job_of(address: str) -> dict[str, Any]:
    (found,) = httpx.get(f"{address}/jobs").json()["jobs"]
    job: dict[str, Any] = httpx.get(f"{address}/jobs/{found['id']}").json()
    return job


def test_ctrl_c_leaves_no_process(tmp_path: Path) -> None:
    home, port = tmp_path / "home", free_port()
    home.mkdir()
    with serving(home, port) as process:
        assert len(descendants(home)) >= 4  # itself, queue server, worker, API
        process.send_signal(signal.SIGINT)
        assert process.wait(20) == 0
    assert not descendants(home)


@pytest.mark.slow
def test_serve_submit_and_stop(tmp_path: Path, tiny_archive: bytes) -> None:
    """Check that `mgsr serve`, `mgsr submit` and a signal give a mesh and a clean end."""
    home, port = tmp_path / "home", free_port()
    home.mkdir()
    scene = tmp_path / "spheres.zip"
    scene.write_bytes(tiny_archive)
    with serving(home, port) as process:
        options = ["--preset", "draft", "--method", "2dgs", *SET, "--server", f"http://127.0.0.1:{port}"]
        ran = run(home, "submit", str(scene), "--wait", "-o", str(tmp_path / "out"), *options)
        assert ran.returncode == 0, ran.stdout + ran.stderr
        assert "train" in ran.stdout and "mesh.ply" in ran.stdout
        assert len(trimesh.load_mesh(tmp_path / "out/mesh.ply").faces) > 500
        assert (tmp_path / "out/report.html").exists() and (tmp_path / "out/renders/test/r_0.png").exists()
        job = httpx.get(f"http://127.0.0.1:{port}/jobs").json()["jobs"][0]["id"]
        again = run(home, "fetch", job, "-o", str(tmp_path / "again"), "--server", f"http://127.0.0.1:{port}")
        assert again.returncode == 0, again.stdout + again.stderr
        first, second = ({path.name for path in (tmp_path / name).rglob("*")} for name in ("out", "again"))
        assert first == second and not any(name.endswith(".partial") for name in first)
        process.send_signal(signal.SIGINT)
        assert process.wait(20) == 0
    assert not descendants(home)


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_job_survives_a_stop_and_a_kill_of_everything(tmp_path: Path, tiny_archive: bytes) -> None:
    home, port = tmp_path / "home", free_port()
    home.mkdir()
    address = f"http://127.0.0.1:{port}"
    with serving(home, port) as process:
        query, head = {"options": json.dumps(LONG_OPTIONS)}, {"Content-Type": "application/zip"}
        httpx.post(f"{address}/jobs", params=query, timeout=30, content=tiny_archive, headers=head)
        wait_until(lambda: job_of(address)["step"] == "train", START_SECONDS)
        process.send_signal(signal.SIGINT)
        process.wait(40)
        assert not descendants(home)
    with serving(home, port) as process:
        wait_until(lambda: job_of(address)["attempt"] == 2, 60)
        wait_until(lambda: job_of(address)["step"] == "train", START_SECONDS)
        process.kill()
        wait_until(lambda: not descendants(home))
    with serving(home, port) as process:
        wait_until(lambda: job_of(address)["attempt"] == 3, 60)
        wait_until(lambda: job_of(address)["step"] == "train", START_SECONDS)
        second = run(home, "serve", "--port", str(free_port()))
        assert second.returncode == 2 and "runs on" in second.stderr
        same_port = run(tmp_path, "serve", "--port", str(port))
        assert same_port.returncode == 2 and "choose another --port" in same_port.stderr
        process.send_signal(signal.SIGTERM)
        process.wait(40)


@pytest.mark.slow
def test_what_dies_is_started_again(tmp_path: Path) -> None:
    home, port = tmp_path / "home", free_port()
    home.mkdir()
    address = f"http://127.0.0.1:{port}"
    with serving(home, port) as process:
        wait_until(lambda: httpx.get(f"{address}/readyz").json().get("workers") == 1)
        for victim in [pid for pid in descendants(home) if pid != process.pid]:
            os.kill(victim, signal.SIGKILL)
        wait_until(lambda: ready(address), 30)
        process.send_signal(signal.SIGTERM)
        assert process.wait(20) == 0


def ready(address: str) -> bool:
    try:
        answer = httpx.get(f"{address}/readyz")
    except httpx.TransportError:
        return False
    return answer.status_code == 200 and answer.json()["workers"] >= 1


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nowhere"], "or a video, but it does not exist"),
        (["SCENE", "--set", "max_sied=3"], "data.max_side"),
        (["SCENE", "--set", "object_box=1,2"], 'data.object_box: expected a string such as "-1,-1,0,1,1,2"'),
        (["SCENE", "--preset", "best"], "draft"),
        (["SCENE", "--server", "http://127.0.0.1:1"], "mgsr serve"),
    ],
)
def test_submit_says_what_is_wrong(arguments: list[str], said: str, tmp_path: Path, tiny_archive: bytes) -> None:
    (tmp_path / "scene.zip").write_bytes(tiny_archive)
    words = [str(tmp_path / "scene.zip") if word == "SCENE" else word for word in arguments]
    ran = run(tmp_path, "submit", *words)
    assert ran.returncode == 2 and said in ran.stderr, ran.stderr


def test_the_library_commands_need_no_service() -> None:
    """Check that `mgsr run` and the others load nothing of the service's packages."""
    blocked = ("fastapi", "uvicorn", "redis", "rq", "obstore", "httpx", "pydantic_settings")
    code = f"import sys\nfor name in {blocked}: sys.modules[name] = None\nimport program.__main__, program.worker"
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT, timeout=60)
