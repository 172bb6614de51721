"""`mgsr-worker`, also as `python -m program.worker`: the worker, and the library's command `run` for one run here."""

from __future__ import annotations

from mgsr.cli.run import run
from worker.cli import app

__all__ = ["app"]

app.command()(run)

if __name__ == "__main__":
    app(prog_name="mgsr-worker")
