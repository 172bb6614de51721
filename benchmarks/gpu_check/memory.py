"""Memory and time of large models, and renderings with hardly any memory left.

First, renderings of 1, 3 and 6 million splats, forward and backward: their time and the most memory that they take.
Then one of them again, with a ballast that leaves a share of that memory free. It must give the same pixels, in bands
if need be, or be refused by a GpuError; nothing else. At least one that did not fit whole must have been rendered.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import asdict, dataclass
from typing import Protocol

import torch
from torch import Tensor

from benchmarks.gpu_check.arguments import parser, require_gpu, results_of
from benchmarks.gpu_check.results import tell
from benchmarks.rasterizers import Scene, make_scene, our_modes
from mgsr.errors import GpuError

SIZES = ("1M/1080p", "3M/1080p", "6M/1080p")
STARVED = "3M/1080p"
MODES = ("dual", "2d")
# Of the memory that the rendering takes when it has enough.
SHARES = (1.1, 0.8, 0.6, 0.45, 0.3, 0.2)
TOLERANCE = 1e-5  # of a gradient's largest number: bands add float32 numbers in another order


@dataclass(frozen=True)
class Rendered:
    """Images and gradients, on the CPU."""

    images: list[Tensor]
    gradients: list[Tensor]


class Memory(Protocol):
    """A GPU's memory."""

    def peak_of(self, render: Callable[[], Rendered]) -> tuple[Rendered, int]:
        """Return what `render` gives, and the most bytes that it takes beside what is held already."""

    def leaving(self, count: int) -> AbstractContextManager[None]:
        """Leave so many bytes free within the block."""


@dataclass(frozen=True)
class Outcome:
    """The outcome of a rendering with so many bytes free.

    state: same, other (other pixels or gradients), refused (by a GpuError), failed (by anything else); detail: the
    message, or the largest difference of gradients, relative.
    """

    share: float
    free: int
    state: str
    detail: str


class GpuMemory:
    """The memory of the current GPU, as torch uses it."""

    def peak_of(self, render: Callable[[], Rendered]) -> tuple[Rendered, int]:
        torch.cuda.empty_cache()
        torch.cuda.reset_peak_memory_stats()
        held = torch.cuda.memory_allocated()
        return render(), torch.cuda.max_memory_allocated() - held

    @contextmanager
    def leaving(self, count: int) -> Iterator[None]:
        torch.cuda.empty_cache()
        free, _ = torch.cuda.mem_get_info()
        ballast = torch.empty(max(0, free - count), dtype=torch.uint8, device="cuda")
        try:
            yield
        finally:
            del ballast
            torch.cuda.empty_cache()


def starved(render: Callable[[], Rendered], memory: Memory, shares: Sequence[float] = SHARES) -> Iterator[Outcome]:
    """Yield the outcomes of a rendering with shares of the memory that it takes, the largest first.

    Each is compared with the rendering that had enough. After one that failed, nothing more is tried: the GPU may be
    unusable.
    """
    whole, peak = memory.peak_of(render)
    for share in shares:
        free = round(share * peak)
        with memory.leaving(free):
            state, detail = _attempt(render, whole)
        yield Outcome(share, free, state, detail)
        if state == "failed":
            return


def _attempt(render: Callable[[], Rendered], whole: Rendered) -> tuple[str, str]:
    try:
        found = render()
    except GpuError as error:
        return "refused", str(error)
    except Exception as error:  # whatever it is, it is what this step is there to find
        return "failed", f"{type(error).__name__}: {str(error).splitlines()[0]}"
    same = all(torch.equal(a, b) for a, b in zip(found.images, whole.images, strict=True))
    difference = max(_difference(a, b) for a, b in zip(found.gradients, whole.gradients, strict=True))
    return ("same" if same and difference <= TOLERANCE else "other"), f"{difference:.1e}"


def _difference(found: Tensor, expected: Tensor) -> float:
    """Return the largest difference relative to the largest number expected; infinite where there is a NaN."""
    largest = float((found - expected).abs().max()) / max(float(expected.abs().max()), 1e-30)
    return largest if largest == largest else float("inf")


def verdict(outcomes: Sequence[Outcome]) -> str | None:
    """Return what is wrong with the outcomes; None where nothing is."""
    bad = [outcome for outcome in outcomes if outcome.state in ("other", "failed")]
    if bad:
        return f"with {bad[0].share:.2f} of its memory: {bad[0].state}, {bad[0].detail}"
    if not any(outcome.state == "same" and outcome.share < 1 for outcome in outcomes):
        return "no rendering succeeded with too little memory, so bands did not help"
    return None


def rendering(scene: Scene, mode: str) -> Callable[[], Rendered]:
    """Return a function that renders a scene forward and backward, with the results on the CPU."""
    render = our_modes(scene)[mode]

    def go() -> Rendered:
        for leaf in (*scene.leaves, *scene.reflected):
            leaf.grad = None  # also of a rendering that was broken off
        images = render()
        torch.autograd.backward(images, [torch.ones_like(image) for image in images])
        gradients = [leaf.grad.cpu() for leaf in (*scene.leaves, *scene.reflected) if leaf.grad is not None]
        return Rendered([image.detach().cpu() for image in images], gradients)

    return go


def main() -> None:
    args = parser(__doc__).parse_args()
    require_gpu(args.device)
    if args.device != "cuda":
        raise SystemExit("memory: this step needs a GPU")
    results, memory, wrong = results_of(args), GpuMemory(), list[str]()
    for size in SIZES:
        scene = make_scene(size, torch.device("cuda"))
        for mode in MODES:
            go = rendering(scene, mode)
            go()
            started_at = time.perf_counter()
            _, peak = memory.peak_of(go)
            spent = time.perf_counter() - started_at
            results.row(step="memory", size=size, mode=mode, peak_mib=peak / 2**20, seconds=spent)
            tell(
                f"{size} {mode}: at most {peak / 2**20:.0f} MiB in addition to the splats, {spent * 1000.0:.0f} ms "
                "with copies"
            )
        del scene, go
    scene = make_scene(STARVED, torch.device("cuda"))
    for mode in MODES:
        outcomes = list[Outcome]()
        for outcome in starved(rendering(scene, mode), memory):
            outcomes.append(outcome)
            results.row(step="starved", size=STARVED, mode=mode, **asdict(outcome))
            tell(f"{STARVED} {mode}, {outcome.free / 2**20:.0f} MiB free: {outcome.state}, {outcome.detail}")
        bad = verdict(outcomes)
        wrong += [] if bad is None else [f"{mode}: {bad}"]
    if wrong:
        raise SystemExit("; ".join(wrong))


if __name__ == "__main__":
    main()
