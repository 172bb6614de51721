"""The job process: unpacks and reconstructs one scene.

It has no access to Redis, to the store and to secrets, because it reads untrusted uploads. A file contains its task. It
answers with lines of JSON and a result file.

Run `python -m worker.job`. MGSR_JOB names the file of the task, and MGSR_JOB_PARENT is the worker's process id.
"""

from __future__ import annotations

import contextlib
import dataclasses
import errno
import json
import os
import sys
import time
import traceback
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel

from service.contract.lifeline import die_with_parent
from service.contract.options import JobOptions

if TYPE_CHECKING:
    from mgsr.pipeline.progress import Event, EventCallback

# The file descriptor of the pipe to the worker.
EVENTS_FD = 3
# The niceness of the process. The watching worker, and the API on a laptop, have priority.
NICE = 5


class JobSpec(BaseModel):
    """The task from the worker. All files are in the attempt's scratch folder."""

    options: JobOptions
    archive: Path
    scene: Path
    out: Path
    previews: Path
    result: Path
    resume: bool
    checkpoint_seconds: float
    max_members: int
    max_unpacked: int
    max_ratio: float
    max_pixels: int


class JobResult(BaseModel):
    """The result of the process. status: succeeded, stopped (on request), or failed with a code and a message."""

    status: str
    code: str = ""
    message: str = ""


def main() -> None:
    """Run the job that the environment names."""
    die_with_parent(int(os.environ["MGSR_JOB_PARENT"]))
    _first_to_go()
    os.nice(NICE)
    spec = JobSpec.model_validate_json(Path(os.environ["MGSR_JOB"]).read_text())
    result = _run(spec)
    partial = spec.result.with_suffix(".partial")
    partial.write_text(result.model_dump_json())
    os.replace(partial, spec.result)
    # All files are written. A regular exit would spend another second on destroying objects of Torch and Open3D.
    os._exit(0)


def _run(spec: JobSpec) -> JobResult:
    from mgsr.errors import Cancelled, MgsrError

    try:
        _reconstruct(spec)
    except Cancelled as stop:
        return JobResult(status="stopped", message=str(stop))
    except KeyboardInterrupt:
        return JobResult(status="stopped", message="stopped immediately")
    except MgsrError as error:
        return JobResult(status="failed", code=error.code, message=_without_folders(str(error), spec))
    except MemoryError:
        return JobResult(status="failed", code="out_of_memory", message="the job ran out of memory")
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            return JobResult(status="failed", code="disk_full", message=f"the worker's disk is full: {error}")
        return _unexpected(error)
    except Exception as error:
        return _unexpected(error)
    return JobResult(status="succeeded")


def _reconstruct(spec: JobSpec) -> None:
    from mgsr.config import make_config
    from mgsr.pipeline.stop_signals import stop_on_signals
    from worker.images import check_images

    started_at = time.perf_counter()
    with stop_on_signals() as stop:
        emit("step", step="unpack", text="unpacking the archive", progress=0.0, eta_seconds=None)
        _unpack(spec)
        check_images(spec.scene, spec.max_pixels)
        options = spec.options
        watch = ["watch.report_every=5", "watch.preview_every=200"]
        # An upload must not make the job read files outside it, such as other jobs' photographs.
        always = [f"watch.checkpoint_seconds={spec.checkpoint_seconds}", "data.confined=on"]
        config = make_config(options.preset, options.method, options.seed, [*watch, *options.overrides(), *always])

        from mgsr.pipeline.estimate import write_estimate
        from mgsr.pipeline.result_paths import LOG, OBJECT
        from mgsr.pipeline.run import run_scene
        from mgsr.pipeline.run_context import RunControl
        from mgsr.pipeline.run_display import RunDisplay
        from worker.reporting import Reporter

        with RunDisplay(spec.out / LOG, append=spec.resume) as display:
            report = Reporter(spec.previews, partial(_tell, spec), partial(_log, spec, display))
            # The scene is given by its relative name, so that report and log do not contain the worker's folders.
            os.chdir(spec.scene.parent)
            if options.dry_run:
                write_estimate(Path(spec.scene.name), spec.out, config, options.device, report, stop)
                return
            kept = (spec.out / OBJECT).is_file()
            control = RunControl(spec.resume, report, stop, started_at, reuse_object=kept)
            run_scene(Path(spec.scene.name), spec.out, config, options.device, control)


def _unpack(spec: JobSpec) -> None:
    """Unpack the archive into the scene's folder, or move a single video there."""
    from mgsr.data.archive import ArchiveLimits, unpack
    from mgsr.data.video import suffix_by_content

    suffix = suffix_by_content(spec.archive)
    if suffix is None:
        unpack(spec.archive, spec.scene, ArchiveLimits(spec.max_members, spec.max_unpacked, spec.max_ratio))
        return
    spec.scene.mkdir(parents=True)
    os.link(spec.archive, spec.scene / f"{spec.scene.name}{suffix}")


def emit(kind: str, **data: Any) -> None:
    """Send the worker an event. Errors are ignored, as this process ends soon if the worker is gone."""
    with contextlib.suppress(BrokenPipeError):
        os.write(EVENTS_FD, (json.dumps({"event": kind, **data}) + "\n").encode())


def _tell(spec: JobSpec, kind: str, **data: Any) -> None:
    """Send the worker an event for users, without the worker's own paths."""
    emit(kind, **{name: _without_folders(value, spec) if name == "text" else value for name, value in data.items()})


def _log(spec: JobSpec, display: EventCallback, event: Event) -> None:
    """Log an event for users, without the worker's own paths."""
    display(dataclasses.replace(event, text=_without_folders(event.text, spec)))


def _unexpected(error: BaseException) -> JobResult:
    traceback.print_exception(error, file=sys.stderr)
    return JobResult(status="failed", code="internal", message=f"{type(error).__name__}: {error}")


def _without_folders(text: str, spec: JobSpec) -> str:
    """Remove the worker's own paths, which mean nothing to the reader, from a message."""
    for folder, name in ((spec.scene, "archive"), (spec.out, "results")):
        text = text.replace(f"{folder}/", "").replace(str(folder), name)
    return text


def _first_to_go() -> None:
    """Make the kernel kill this process, not the worker, when memory runs out."""
    with contextlib.suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text("800")


if __name__ == "__main__":
    main()
