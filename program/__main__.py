"""`mgsr`, also as `python -m program`."""

from __future__ import annotations

from mgsr.cli.main import app
from service.commands import add_commands

__all__ = ["app"]

add_commands(app)

if __name__ == "__main__":
    app(prog_name="mgsr")
