"""`mgsr serve`: queue server, worker and API as children of one process, which restarts them if they die."""

from __future__ import annotations

import fcntl
import socket
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from redis import Redis, RedisError

from service.contract.children import Child, Stop, keep_alive, stop_on_signals
from service.contract.errors import SetupError
from service.contract.settings import Settings
from service.contract.valkey import prepare_server

READY_SECONDS = 30.0


def serve(settings: Settings, host: str, port: int) -> None:
    """Serve until SIGINT or SIGTERM. Raises SetupError if a child can't be started or keeps dying."""
    _check_port(host, port)
    with _alone(settings.home):
        children = _children(settings, host, port)
        stop_on_signals()
        at_once = False
        try:
            _run(children, f"http://{host}:{port}")
        except Stop:
            print("Stopping. A running job writes a checkpoint and continues at the next start.", file=sys.stderr)
        finally:
            for child in reversed(children):
                try:
                    child.stop(at_once)
                except Stop:
                    at_once = True
                    child.stop(at_once)


def _children(settings: Settings, host: str, port: int) -> list[Child]:
    """Return the children in the order in which they start. They stop in reverse order."""
    children: list[Child] = []
    url = settings.redis_url
    if url is None:
        server = prepare_server(settings.home)
        url = server.url
        children.append(Child("queue server", server.command, {}, 10.0))
    environment = {"MGSR_REDIS_URL": url, "MGSR_HOME": str(settings.home)}
    worker = [sys.executable, "-m", "worker.cli"]
    api = [sys.executable, "-m", "service.cli", "--host", host, "--port", str(port)]
    children.append(Child("worker", worker, environment, settings.stop_grace + 10.0))
    children.append(Child("API", api, environment, 10.0))
    return children


def _run(children: list[Child], address: str) -> None:
    for child in children:
        child.start()
        if child.name == "queue server":
            _wait_for_queue(children)
    _wait_for_api(children, address)
    print(f"MGSR listens on {address} (API documentation: {address}/docs). Ctrl-C stops everything.", flush=True)
    keep_alive(children)


def _wait_for_queue(children: list[Child]) -> None:
    """Wait until the queue server, the first child, answers."""
    redis = Redis.from_url(children[1].environment["MGSR_REDIS_URL"], socket_timeout=1.0)
    for _ in _tries(children[0]):
        with suppress(RedisError):
            redis.ping()
            return


def _wait_for_api(children: list[Child], address: str) -> None:
    host, _, port = address.removeprefix("http://").rpartition(":")
    for _ in _tries(children[-1]):
        with suppress(OSError), socket.create_connection((host, int(port)), 1.0):
            return


def _tries(child: Child) -> Iterator[None]:
    ends = time.monotonic() + READY_SECONDS
    while time.monotonic() < ends:
        assert child.process is not None
        if child.process.poll() is not None:
            raise SetupError(f"the {child.name} did not start; its output above says why")
        yield
        time.sleep(0.05)
    raise SetupError(f"the {child.name} did not answer within {READY_SECONDS:g} s")


def _check_port(host: str, port: int) -> None:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError as error:
            raise SetupError(
                f"cannot listen on {host}, port {port}: {error.strerror}; choose another --port"
            ) from error


@contextmanager
def _alone(home: Path) -> Iterator[None]:
    """Hold the lock of this service's folder. The kernel releases it even if this process is killed.

    Raises SetupError if another service holds it.
    """
    home.mkdir(parents=True, exist_ok=True, mode=0o700)
    with (home / "serve.lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise SetupError(
                f"`mgsr serve` already runs with {home}; stop it, or set MGSR_HOME to another folder"
            ) from error
        yield
