"""`mgsr-worker health`, asked of real workers."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time

import pytest
from redis import Redis

import worker.health
from tests.service.stack import ROOT, Stack, free_port
from worker.health import worker_health


def _ask(stack: Stack) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "worker.cli", "health"]
    return subprocess.run(command, env=stack.environment, cwd=ROOT, capture_output=True, text=True, timeout=60)


def test_a_living_worker_is_healthy(stack: Stack) -> None:
    answer = _ask(stack)
    assert answer.returncode == 0, answer.stdout + answer.stderr
    assert os.uname().nodename in answer.stdout


def test_workers_of_other_machines_do_not_count(stack: Stack, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(socket, "gethostname", lambda: "elsewhere")
    alive, line = worker_health(stack.redis)
    assert not alive and "elsewhere" in line


def test_one_that_has_fallen_silent_is_not_healthy(stack: Stack, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(worker.health, "SILENT_SECONDS", 0.0)
    time.sleep(0.01)
    assert not worker_health(stack.redis)[0]


def test_a_queue_that_is_away_is_not_the_workers_fault() -> None:
    alive, line = worker_health(Redis(port=free_port()))
    assert alive and "Redis does not answer" in line
