"""`mgsr submit`, `rerun` and `fetch`: send a scene, follow the job and fetch its results."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import Any

import httpx
from rich.console import Console
from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn

from service.client.api import Client, DamagedDownload, Job, ServiceRefusal
from service.client.packing import packed
from service.client.unfinished import default_folder
from service.contract.errors import SetupError
from service.contract.options import JobOptions

FAILED = 1
INTERRUPTED = 130
_NAMED = 3  # photographs that the line of a finding names


def submit_scene(server: str, key: str | None, scene: Path, options: JobOptions, out: Path | None) -> int:
    """Send a scene, and return the program's exit code.

    With `out`, wait for the job and put its results there. Raises SetupError if the scene can't be sent or the service
    refuses it.
    """

    def talk(client: Client, console: Console) -> int:
        with packed(scene) as archive:
            client.check()
            job = _send(client, archive, options, console)
        return _sent(job, client, server, out, console)

    return _talk(server, key, talk)


def rerun_job(server: str, key: str | None, job: str, options: dict[str, Any], out: Path | None) -> int:
    """Run an earlier job again with other options, and return the program's exit code.

    With `out`, wait for the new job and put its results there. Raises SetupError if the service refuses it.
    """

    def talk(client: Client, console: Console) -> int:
        return _sent(client.rerun(job, options), client, server, out, console)

    return _talk(server, key, talk)


def list_jobs(server: str, key: str | None, limit: int) -> int:
    """Print the newest jobs, one per line, and return the exit code. Raises SetupError if the service refuses."""

    def talk(client: Client, console: Console) -> int:
        for job in client.jobs(limit):
            console.print(_job_line(job), soft_wrap=True, markup=False)
        return 0

    return _talk(server, key, talk)


def pin_job(server: str, key: str | None, job: str, pinned: bool) -> int:
    """Pin or unpin a job, print it, and return the exit code. Raises SetupError if the service refuses."""

    def talk(client: Client, console: Console) -> int:
        console.print(_job_line(client.pin(job, pinned)), soft_wrap=True, markup=False)
        return 0

    return _talk(server, key, talk)


def fetch_job(server: str, key: str | None, job: str, out: Path) -> int:
    """Follow a job, put its results into `out`, and return the exit code. Raises SetupError if the service refuses."""
    return _talk(server, key, lambda client, console: _wait(client, job, out, console))


def _talk(server: str, key: str | None, talk: Callable[[Client, Console], int]) -> int:
    """Call `talk` with a client, and return its exit code. Raises SetupError for errors of the service."""
    console = Console(highlight=False)
    try:
        with Client(server, key, default_folder()) as client:
            return talk(client, console)
    except ServiceRefusal as refusal:
        raise SetupError(f"{server} refuses: {refusal} ({refusal.code})") from refusal
    except httpx.HTTPError as error:
        raise SetupError(f"{server} does not answer: {error}; check that `mgsr serve` runs there") from error
    except DamagedDownload as error:
        raise SetupError(str(error)) from error
    except KeyboardInterrupt:
        console.print(
            "a submitted job continues without this program; `mgsr fetch ID` follows it and fetches its results. The "
            "same `mgsr submit` continues a large upload where it stopped",
            soft_wrap=True,
        )
        return INTERRUPTED


def _send(client: Client, scene: Path, options: JobOptions, console: Console) -> Job:
    with _transfer("sending", console) as progress:
        return client.submit(scene, options.model_dump(mode="json"), progress)


@contextmanager
def _transfer(what: str, console: Console) -> Iterator[Callable[[int, int], None]]:
    """Show the progress of a transfer. Yields a callback for the numbers of transferred bytes and of all bytes."""
    with Progress(TextColumn(what), BarColumn(), DownloadColumn(), console=console, transient=True) as bar:
        task = bar.add_task(what, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


def _sent(job: Job, client: Client, server: str, out: Path | None, console: Console) -> int:
    """Print the id of a submitted job, and with `out` wait for its results."""
    console.print(f"job {job['id']}: {server.rstrip('/')}/jobs/{job['id']}", soft_wrap=True)
    return 0 if out is None else _wait(client, job["id"], out, console)


def _wait(client: Client, job: str, out: Path, console: Console) -> int:
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.percentage:3.0f}%"))
    said, shown = "", False
    with Progress(*columns, TextColumn("{task.fields[detail]}"), console=console) as bar:
        task = bar.add_task("queued", total=1.0, detail="")
        for now in client.follow(job):
            bar.update(task, description=_place(now), completed=now["progress"], detail=_detail(now))
            if now.get("findings") is not None and not shown:
                shown = True
                for finding in now["findings"]:
                    console.print(_finding_line(finding), soft_wrap=True, markup=False)
            if not console.is_terminal and (line := _place(now)) != said:
                said = line
                console.print(line)
    return _fetch(client, now, out, console)


def _job_line(job: Job) -> str:
    stays = "pinned" if job["pinned"] else ""
    if job["expires"] is not None:
        stays = f"expires {datetime.fromisoformat(job['expires']).astimezone():%Y-%m-%d %H:%M}"
    parts = (job["id"], f"{job['status']:9}", job["created"][:16].replace("T", " "), stays, job["name"] or "")
    return "  ".join(part for part in parts if part)


def _finding_line(finding: dict[str, Any]) -> str:
    names = finding["photographs"]
    named = f" ({', '.join(names[:_NAMED])}{', ...' if len(names) > _NAMED else ''})" if names else ""
    return f"{finding['severity']}: {finding['text']}{named}; {finding['cure']}"


def _place(job: Job) -> str:
    if job["status"] != "running":
        return str(job["status"])
    return f"{job.get('step') or 'starting'} {job.get('stage') or ''}".strip()


def _detail(job: Job) -> str:
    left, step_left, psnr = (job.get(name) for name in ("eta_seconds", "step_eta_seconds", "psnr"))
    parts = [] if left is None else [f"about {left:.0f} s left"]
    if left is None and step_left is not None:
        parts = [f"about {step_left:.0f} s for this step"]
    return ", ".join(parts if psnr is None else [*parts, f"{psnr:.1f} dB"])


def _fetch(client: Client, job: Job, out: Path, console: Console) -> int:
    if job["status"] != "succeeded":
        error = job.get("error")
        text = f"{error['message']} ({error['code']})" if error else "by request"
        console.print(f"{job['status']}: {text}", soft_wrap=True)
        return FAILED
    if job["options"]["dry_run"]:
        for each in job["metrics"]["estimate"]:
            memory = each["memory_mib"] / 1024
            console.print(f"{each['preset']:9} up to about {each['seconds']:.0f} s and {memory:.1f} GiB", markup=False)
        return 0
    with _transfer("fetching", console) as progress:
        client.fetch(job["id"], out, progress)
    console.print(f"mesh   {out / 'mesh.ply'}\nreport {out / 'report.html'}", soft_wrap=True)
    return 0
