"""One worker for each card, by one command."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.service.stack import ROOT, TINY_OPTIONS, Stack


@pytest.mark.slow
def test_a_worker_for_each_card(tmp_path: Path, tiny_archive: bytes) -> None:
    """Jobs that ask for a card wait for a worker that has one; a signal to the first process ends all."""
    with Stack(tmp_path, workers=1) as stack:
        job = stack.submitted(tiny_archive, TINY_OPTIONS | {"device": "cuda"})
        other = stack.submitted(tiny_archive, TINY_OPTIONS)
        stack.wait_for(other, "succeeded")
        assert stack.job(job)["status"] == "queued"
        command = [sys.executable, "-m", "worker.cli", "--gpus", "0,1"]
        with subprocess.Popen(command, env=stack.environment, cwd=ROOT) as workers:
            stack.wait_until_ready(3)
            stack.finished(job)
            workers.terminate()
            assert workers.wait(30) == 0
        assert stack.http.get("/readyz").json()["workers"] == 1
