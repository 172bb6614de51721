"""Profile iterations in the middle of a training: of the training loop itself, with guard, statistics and
densification, with the splats that it has there.

Three stretches follow one another in the middle of the last stage: one without any profiler, whose times are the ones
that count; one in which the GPU alone is recorded, for its kernels and the gaps between them; one in which torch's
operations are recorded too, which slows the host down. The second and third end with a densification where there are
some. Training is given up then.
"""

from __future__ import annotations

import time
from collections.abc import Generator, Iterator
from contextlib import closing, suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import torch
from torch.profiler import ProfilerActivity
from torch.profiler import profile as recorder

from benchmarks.gpu_check import trace
from benchmarks.gpu_check.arguments import parser, require_gpu, results_of, work_of
from benchmarks.gpu_check.results import tell
from benchmarks.packed_scenes import Packed, packed_or_ball
from mgsr.config import Config, make_config
from mgsr.errors import Cancelled
from mgsr.training.control import TrainingControl
from mgsr.training.progress import Progress
from mgsr.training.run import Training

LAST_STAGES = ("mutual", "alone")
SHOWN_KERNELS, SHOWN_GAPS, SHOWN_OPERATIONS = 40, 10, 25


@dataclass(frozen=True)
class Stretch:
    """Consecutive iterations: wall milliseconds, and the process's CPU milliseconds in them; events, if recorded."""

    name: str
    iterations: int
    wall: float
    cpu: float
    events: list[trace.Event] = field(default_factory=list, repr=False)

    @property
    def wall_each(self) -> float:
        return self.wall / self.iterations

    @property
    def cpu_each(self) -> float:
        return self.cpu / self.iterations


@dataclass(frozen=True)
class Profile:
    """The three stretches, and where in training they lie."""

    where: Progress
    plain: Stretch
    gpu: Stretch
    all: Stretch


class Watch:
    """A watch that measures the stretches.

    It stands where training asks whether to stop, before every iteration. progress tells of the training's place.
    after: seconds after which the stretches begin wherever training is.
    """

    def __init__(self, config: Config, device: torch.device, count: int, after: float, work: Path) -> None:
        self._every = config.train.surfels.densify.every
        self._device, self._count, self._work = device, count, work
        # Iterations of the plain stretch, and of the others with those before them.
        self._needed = max(self._every, count) + 2 * (count + -count % self._every)
        self._latest = time.monotonic() + after
        self._where: Progress | None = None
        self._stretches: Generator[None, None, None] | None = None
        self.made: list[Stretch] = []

    def progress(self, progress: Progress) -> None:
        """Begin the stretches before the next iteration, where that is the middle."""
        middle = progress.stage in LAST_STAGES and 2 * progress.iteration >= progress.total - self._needed
        aligned = progress.iteration % self._every == 0
        if self._stretches is None and ((middle and aligned) or time.monotonic() > self._latest):
            self._where = replace(progress, previews={})
            self._stretches = self._measure()

    def should_stop(self) -> bool:
        """Return whether everything is measured."""
        if self._stretches is None:
            return False
        return next(self._stretches, True) is True

    def close(self) -> None:
        """Stop what still records: a process that ends while it does crashes."""
        if self._stretches is not None:
            self._stretches.close()

    @property
    def result(self) -> Profile | None:
        """Return the profile; None where training ended before everything was measured."""
        if self._where is None or len(self.made) < 3:
            return None
        return Profile(self._where, *self.made)

    def _measure(self) -> Generator[None, None, None]:
        """Measure the stretches; each step of the generator is one iteration."""
        yield from self._stretch("plain", max(self._every, self._count), None)
        for name, kinds in (("gpu", [ProfilerActivity.CUDA]), ("all", [ProfilerActivity.CPU, ProfilerActivity.CUDA])):
            # The stretch ends with the iteration after which splats are added and removed.
            for _ in range(-self._count % self._every):
                yield
            yield from self._stretch(name, self._count, kinds)

    def _stretch(self, name: str, count: int, kinds: list[ProfilerActivity] | None) -> Generator[None, None, None]:
        there = [kind for kind in kinds or [] if kind is ProfilerActivity.CPU or self._device.type == "cuda"]
        recording = recorder(activities=there) if there else None
        if recording is not None:
            recording.start()
        try:
            self._wait()
            wall, cpu = time.perf_counter(), time.process_time()
            for _ in range(count):
                yield
            self._wait()
            wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        finally:
            if recording is not None:
                recording.stop()
        events = list[trace.Event]()
        if recording is not None:
            file = self._work / f"trace_{name}.json"
            recording.export_chrome_trace(str(file))
            events = trace.read_trace(file)
        self.made.append(Stretch(name, count, wall * 1e3, cpu * 1e3, events))

    def _wait(self) -> None:
        if self._device.type == "cuda":
            torch.cuda.synchronize()


def profiled(
    content: Packed, config: Config, device: torch.device, count: int, after: float, work: Path
) -> Profile | None:
    """Return the profile of `count` iterations in the middle of a training; None where it ended too early for that."""
    watch = Watch(config, device, count, after, work)
    with closing(watch), suppress(Cancelled):
        Training(content.scene, content.start, config, TrainingControl(watch.progress, watch.should_stop), device).run()
    return watch.result


def lines(profile: Profile) -> Iterator[str]:
    """Return the profile, as Markdown."""
    where, plain, gpu, whole = profile.where, profile.plain, profile.gpu, profile.all
    counts = ", ".join(f"{count} {name}" for name, count in where.counts.items())
    yield f"\n### Profile from iteration {where.iteration} of {where.total} of {where.stage}, {counts}\n"
    yield "| iterations | recorded | wall ms each | host CPU ms each |\n|---|---|---|---|"
    for stretch, recorded in ((plain, "nothing"), (gpu, "the GPU"), (whole, "the GPU and torch's operations")):
        yield f"| {stretch.iterations} | {recorded} | {stretch.wall_each:.3f} | {stretch.cpu_each:.3f} |"
    yield ""
    for name, value in numbers(profile).items():
        yield f"- {name.replace('_', ' ')}: {value:.4g}"
    yield "\n| on the GPU | runs each | ms each | median us | share |\n|---|---|---|---|---|"
    for row in trace.kernel_rows(gpu.events, gpu.iterations)[:SHOWN_KERNELS]:
        yield f"| {row.name[:80]} | {row.runs:.2f} | {row.milliseconds:.4f} | {row.median:.1f} | {row.share:.1%} |"
    yield "\n| gap us | after | before |\n|---|---|---|"
    for gap in trace.gaps(gpu.events)[:SHOWN_GAPS]:
        yield f"| {gap.length:.0f} | {gap.before[:60]} | {gap.after[:60]} |"
    yield "\n| torch's operation | each |\n|---|---|"
    for name, count in list(trace.operations(whole.events).items())[:SHOWN_OPERATIONS]:
        yield f"| {name} | {count / whole.iterations:.2f} |"


def numbers(profile: Profile) -> dict[str, float]:
    """Return the figures that the targets are about, by name.

    The GPU's times are of the stretch in which it alone is recorded, the wall's and the host's of the one in which
    nothing is.
    """
    plain, gpu, whole = profile.plain, profile.gpu, profile.all
    busy = trace.busy(gpu.events) / gpu.iterations
    idle = trace.gaps(gpu.events)
    return {
        "wall_ms_each": plain.wall_each,
        "host_cpu_ms_each": plain.cpu_each,
        "host_waiting_ms_each": trace.waits(gpu.events) / gpu.iterations,
        "gpu_busy_ms_each": busy,
        "gpu_busy_share_of_wall": busy / plain.wall_each,
        "gpu_busy_share_of_wall_while_recorded": busy / gpu.wall_each,
        "gaps_ms_each": sum(gap.length for gap in idle) / 1e3 / gpu.iterations,
        "gaps_over_10us_each": sum(gap.length > 10 for gap in idle) / gpu.iterations,
        "kernels_each": trace.launches(gpu.events) / gpu.iterations,
        "torch_operations_each": sum(trace.operations(whole.events).values()) / whole.iterations,
    }


def row(profile: Profile) -> dict[str, Any]:
    """Return the profile for results.jsonl."""
    kernels = trace.kernel_rows(profile.gpu.events, profile.gpu.iterations)
    return {
        "stage": profile.where.stage,
        "iteration": profile.where.iteration,
        "splats": profile.where.counts,
        **numbers(profile),
        "kernels": [asdict(kernel) for kernel in kernels],
    }


def main() -> None:
    made = parser(__doc__)
    made.add_argument("scene", help="a packed scene, or `ball`")
    made.add_argument("--preset", default="high")
    made.add_argument("--set", dest="settings", action="append", default=[], metavar="KEY=VALUE")
    made.add_argument("--iterations", type=int, default=50)
    made.add_argument("--after", type=float, default=120.0, help="the seconds after which to profile")
    args = made.parse_args()
    require_gpu(args.device)
    config = make_config(args.preset, overrides=args.settings)
    content = packed_or_ball(args.scene, config)
    profile = profiled(content, config, torch.device(args.device), args.iterations, args.after, work_of(args))
    if profile is None:
        raise SystemExit("training ended before the profile; use a smaller --after, or more iterations")
    print("\n".join(lines(profile)), flush=True)
    results_of(args).row(step="profile", scene=content.scene.name, preset=args.preset, **row(profile))
    found = numbers(profile)
    tell(
        f"{found['wall_ms_each']:.2f} ms an iteration, the GPU busy for {found['gpu_busy_share_of_wall']:.0%} of it, "
        f"host {found['host_cpu_ms_each']:.2f} ms, {found['kernels_each']:.0f} kernels, "
        f"{found['torch_operations_each']:.0f} torch operations"
    )


if __name__ == "__main__":
    main()
