"""`mgsr-worker`: the same run as `mgsr run`, as the entry of unattended machines."""

from __future__ import annotations

import typer

from mgsr.cli.run import run

app = typer.Typer(add_completion=False, no_args_is_help=True, pretty_exceptions_enable=False)
app.command()(run)


@app.callback()
def main() -> None:
    """Reconstructs scenes. One command a job."""


if __name__ == "__main__":
    app()
