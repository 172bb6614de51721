"""The commands of `mgsr` that concern the service: serve, submit, rerun, fetch, jobs, pin, retention, keys."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from service.contract.errors import SetupError, refusals

if TYPE_CHECKING:
    from service.keys import Keys

DEFAULT_SERVER = "http://127.0.0.1:8000"

HostOption = Annotated[str, typer.Option(help="The address to listen on.")]
PortOption = Annotated[int, typer.Option(help="The port to listen on.", min=1, max=65535)]
ServerOption = Annotated[str, typer.Option(help="The service's address.", envvar="MGSR_SERVER", metavar="URL")]

keys = typer.Typer(no_args_is_help=True, help="Manage the bearer keys of the service. MGSR_STORE names its store.")


def add_commands(app: typer.Typer) -> None:
    """Add these commands to a program."""
    app.command()(serve)
    app.command()(submit)
    app.command()(rerun)
    app.command()(fetch)
    app.command()(jobs)
    app.command()(pin)
    app.command()(retention)
    app.add_typer(keys, name="keys")


def serve(host: HostOption = "127.0.0.1", port: PortOption = 8000) -> None:
    """Start queue, worker and API on this machine. Ctrl-C stops them; jobs continue at the next start."""
    with refusals():
        from service.contract.settings import Settings
        from service.serve import serve as serve_all

        serve_all(Settings(), host, port)


def submit(
    scene: Annotated[Path, typer.Argument(metavar="SCENE", help="A folder or archive of photographs, or a video.")],
    wait: Annotated[bool, typer.Option("--wait", help="Follow the job, and fetch its results at the end.")] = False,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="OUT", help="The folder for the results. The default is out/SCENE."),
    ] = None,
    preset: Annotated[str, typer.Option(help="The amount of work: draft, standard or high.")] = "standard",
    method: Annotated[str, typer.Option(help="The branches to train: mgsr, 2dgs or 3dgs.")] = "mgsr",
    seed: Annotated[int, typer.Option(min=0)] = 0,
    settings: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Change one setting. Repeat it for several.")
    ] = None,
    dry_run: Annotated[
        bool,
        typer.Option(
            "--dry-run", help="Only check the photographs and estimate the cost of each preset. Waits for the result."
        ),
    ] = False,
    webhook: Annotated[
        str | None,
        typer.Option(metavar="URL", help="The address to call when the job ends, signed as in Standard Webhooks."),
    ] = None,
    server: ServerOption = DEFAULT_SERVER,
) -> None:
    """Send SCENE to a service. MGSR_KEY holds the key, if the service needs one."""
    with refusals():
        from service.client.submit import submit_scene
        from service.contract.options import JobOptions, parse_setting

        try:
            chosen = dict(parse_setting(text) for text in settings or [])
            # The service checks the options by the rules of its own version.
            fields = {"name": scene.resolve().name[:200], "preset": preset, "method": method, "seed": seed}
            options = JobOptions.model_validate(fields | {"settings": chosen, "webhook": webhook, "dry_run": dry_run})
        except ValueError as error:
            raise SetupError(str(error)) from error
        folder = (out or Path("out") / scene.resolve().stem) if wait or dry_run else None
        raise typer.Exit(submit_scene(server, os.environ.get("MGSR_KEY"), scene, options, folder))


def rerun(
    job: Annotated[str, typer.Argument(metavar="ID", help="The earlier job's id, as printed by `mgsr submit`.")],
    wait: Annotated[bool, typer.Option("--wait", help="Follow the new job, and fetch its results at the end.")] = False,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="OUT", help="The folder for the results. The default is out/ID."),
    ] = None,
    preset: Annotated[
        str | None, typer.Option(help="draft, standard or high. The default is the earlier job's preset.")
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="KEY=VALUE", help="Change one setting. This replaces all settings of the earlier job."
        ),
    ] = None,
    server: ServerOption = DEFAULT_SERVER,
) -> None:
    """Run an earlier job again with other options, without sending its photographs again."""
    with refusals():
        from service.client.submit import rerun_job
        from service.contract.options import parse_setting

        try:
            changes: dict[str, Any] = {} if preset is None else {"preset": preset}
            if settings:
                changes["settings"] = dict(parse_setting(text) for text in settings)
        except ValueError as error:
            raise SetupError(str(error)) from error
        folder = (out or Path("out") / job) if wait else None
        raise typer.Exit(rerun_job(server, os.environ.get("MGSR_KEY"), job, changes, folder))


def fetch(
    job: Annotated[str, typer.Argument(metavar="ID", help="The job's id, as printed by `mgsr submit`.")],
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="OUT", help="The folder for the results. The default is out/ID."),
    ] = None,
    server: ServerOption = DEFAULT_SERVER,
) -> None:
    """Follow a submitted job, and fetch its results at the end."""
    with refusals():
        from service.client.submit import fetch_job

        raise typer.Exit(fetch_job(server, os.environ.get("MGSR_KEY"), job, out or Path("out") / job))


def jobs(
    limit: Annotated[int, typer.Option(help="The most jobs to list.", min=1, max=200)] = 50,
    server: ServerOption = DEFAULT_SERVER,
) -> None:
    """List your jobs, the newest first: id, status, time of submission, expiry and name."""
    with refusals():
        from service.client.submit import list_jobs

        raise typer.Exit(list_jobs(server, os.environ.get("MGSR_KEY"), limit))


def pin(
    job: Annotated[str, typer.Argument(metavar="ID", help="The job's id, as `mgsr jobs` lists it.")],
    off: Annotated[bool, typer.Option("--off", help="Unpin the job.")] = False,
    server: ServerOption = DEFAULT_SERVER,
) -> None:
    """Keep a job beyond the service's retention."""
    with refusals():
        from service.client.submit import pin_job

        raise typer.Exit(pin_job(server, os.environ.get("MGSR_KEY"), job, not off))


def retention(
    days: Annotated[
        float | None, typer.Option(min=0, help="Days from a job's end to its deletion. The default is MGSR_RETENTION.")
    ] = None,
) -> None:
    """List the jobs that a retention would delete now, without deleting them. MGSR_STORE names the store."""
    with refusals():
        from service.contract.jobs import Jobs
        from service.contract.retention import Retention
        from service.contract.settings import Settings
        from service.contract.store import Store

        settings = Settings()
        seconds = settings.retention if days is None else days * 86400
        if seconds is None:
            raise SetupError("MGSR_RETENTION is not set, so jobs are kept; use --days to try a retention")
        kept = Jobs(Store(settings.store_url, 10.0))
        for state in Retention(kept, seconds).due():
            assert state.outcome is not None
            print(f"{state.record.id}  {state.outcome.status:9}  ended {state.outcome.finished:%Y-%m-%d %H:%M} UTC")


@keys.command("create")
def create_key(name: Annotated[str, typer.Argument(help="The name of the key's owner.")]) -> None:
    """Create a key and show it once. With at least one key, the service answers only requests with a key."""
    with refusals():
        token, key = _keys().create(name)
        print(token)
        typer.echo(
            f"key {key.id} of {name}; keep it, because it is not shown again (Authorization: Bearer ...)", err=True
        )


@keys.command("list")
def list_keys() -> None:
    """List the ids, names and dates of all keys."""
    with refusals():
        for key in _keys().all():
            print(f"{key.id}  {key.created:%Y-%m-%d}  {key.name}")


@keys.command("revoke")
def revoke_key(key_id: Annotated[str, typer.Argument(metavar="ID")]) -> None:
    """Revoke a key. Services notice it within seconds. The jobs of the key stay in the store."""
    with refusals():
        if not _keys().revoke(key_id):
            raise SetupError(f"key {key_id!r} does not exist; `mgsr keys list` shows all keys")


def _keys() -> Keys:
    from service.contract.settings import Settings
    from service.contract.store import Store
    from service.keys import Keys

    return Keys(Store(Settings().store_url, 10.0))
