"""The step that takes the memory away, with a memory that only pretends."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest
import torch

from benchmarks.gpu_check.memory import Outcome, Rendered, rendering, starved, verdict
from benchmarks.rasterizers import make_scene
from mgsr.errors import GpuError

WHOLE = 1000  # bytes
BAND = 250  # bytes of the smallest band


class PretendedMemory:
    """A pretended memory in which a rendering takes WHOLE bytes, or, in bands, BAND."""

    def __init__(self) -> None:
        self.free = 10 * WHOLE
        self.left: list[int] = []

    def peak_of(self, render: Callable[[], Rendered]) -> tuple[Rendered, int]:
        return render(), WHOLE

    @contextmanager
    def leaving(self, count: int) -> Iterator[None]:
        before, self.free = self.free, count
        self.left.append(count)
        yield
        self.free = before


def pretended(memory: PretendedMemory, banded: Callable[[], Rendered] | None) -> Callable[[], Rendered]:
    """Return a rendering that goes in bands, by `banded`, where it does not fit.

    Where `banded` is None, it never does.
    """

    def render() -> Rendered:
        if memory.free >= WHOLE:
            return picture()
        if banded is None:
            raise torch.OutOfMemoryError("CUDA out of memory.\nTried to allocate 1 GiB")
        if memory.free < BAND:
            raise GpuError("a row of tiles is too full")
        return banded()

    return render


def picture(pixel: float = 0.5, gradient: float = 1.0) -> Rendered:
    return Rendered([torch.full((4, 4), pixel)], [torch.ones(2), torch.full((3,), gradient)])


def states(render: Callable[[], Rendered], memory: PretendedMemory) -> list[str]:
    return [outcome.state for outcome in starved(render, memory, (1.1, 0.5, 0.1))]


def test_bands_that_survive() -> None:
    memory = PretendedMemory()
    outcomes = list(starved(pretended(memory, lambda: picture(gradient=1 + 1e-6)), memory, (1.1, 0.5, 0.1)))
    assert memory.left == [1100, 500, 100]
    assert [outcome.state for outcome in outcomes] == ["same", "same", "refused"]
    assert verdict(outcomes) is None


@pytest.mark.parametrize(
    "wrong", [picture(pixel=0.5 + 1e-7), picture(gradient=1.001), picture(gradient=float("nan"))], ids=str
)
def test_bands_that_change_something(wrong: Rendered) -> None:
    memory = PretendedMemory()
    outcomes = list(starved(pretended(memory, lambda: wrong), memory, (1.1, 0.5)))
    assert [outcome.state for outcome in outcomes] == ["same", "other"]
    assert "with 0.50 of its memory: other" in str(verdict(outcomes))


def test_an_error_of_another_kind_ends_it() -> None:
    memory = PretendedMemory()
    outcomes = list(starved(pretended(memory, None), memory, (1.1, 0.5, 0.1)))
    assert [outcome.state for outcome in outcomes] == ["same", "failed"]
    assert outcomes[1].detail == "OutOfMemoryError: CUDA out of memory."
    assert "failed, OutOfMemoryError" in str(verdict(outcomes))


def test_refusals_alone_do_not_do() -> None:
    enough = Outcome(1.1, 1100, "same", "0")
    assert verdict([enough, Outcome(0.5, 500, "refused", "no")]) is not None
    assert verdict([enough, Outcome(0.5, 500, "same", "0")]) is None


def test_a_rendering_begins_without_the_last_one_s_gradients() -> None:
    go = rendering(make_scene("1k/32", torch.device("cpu")), "dual")
    first = [gradient.clone() for gradient in go().gradients]
    assert len(first) == 8
    assert all(torch.equal(a, b) for a, b in zip(first, go().gradients, strict=True))
