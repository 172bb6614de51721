"""`mgsr-worker`: processes jobs of the service.

`mgsr-worker run` does the same as `mgsr run`, without the service. `mgsr-worker health` is for health checks.
"""

from __future__ import annotations

from typing import Annotated

import typer

from service.contract.errors import refusals

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)

GpusOption = Annotated[
    str | None,
    typer.Option(metavar="all|0,1", help="Start one worker per NVIDIA GPU, for jobs that request a GPU."),
]


@app.callback(invoke_without_command=True)
def main(context: typer.Context, gpus: GpusOption = None) -> None:
    """Process jobs from the queue at MGSR_REDIS_URL and the store at MGSR_STORE, until stopped.

    When stopped, a running job writes a checkpoint and returns to the queue. The command `run` makes a single run
    without queue and store.
    """
    if context.invoked_subcommand is not None:
        return
    with refusals():
        from worker.start import start_workers

        start_workers(gpus)


@app.command()
def health() -> None:
    """Report whether a worker of this machine is alive, for health checks. The exit code is 1 if there is none."""
    with refusals():
        from service.contract.queue import connect
        from service.contract.settings import Settings
        from worker.health import worker_health

        alive, line = worker_health(connect(Settings().need_redis()))
    print(line)
    raise typer.Exit(0 if alive else 1)


if __name__ == "__main__":
    app()
