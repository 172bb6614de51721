"""An image whose pairs of splats and tiles are too many for the memory is worked in bands of rows of tiles.

Memory that is too small is played: by a limit of pairs, and by an error at one of the places, every launch and every
tensor that torch makes, at which a GPU may report it.
"""

from __future__ import annotations

import ctypes
import weakref
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import count, pairwise
from typing import Any

import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode

from mgsr.data.camera import Camera
from mgsr.errors import GpuError
from mgsr.native.cuda import bands
from mgsr.native.cuda.launcher import use_launcher
from mgsr.native.cuda.tiles import Band
from mgsr.ops.gaussians import GaussianRaster, Reflected, rasterize_gaussians
from mgsr.ops.surfels import SurfelOptions, SurfelRaster, rasterize_surfels
from tests.cuda.machines import SHIM, Machine, on_each_machine
from tests.cuda_shim.launcher import ShimLauncher
from tests.ops.splat_scenes import camera, random_splats, splat_arguments
from tests.ops.test_gaussians import dual_splats

VIEW = camera().resized(120, 84)  # 8 x 6 tiles
ROWS = 6
KINDS = ("single", "dual", "surfels", "distortion")
SOME_SLOW = [pytest.param(kind, marks=[pytest.mark.slow] if kind in ("dual", "distortion") else []) for kind in KINDS]
IMAGES = ("color", "alpha", "depth", "reflected", "weight", "median_depth", "normal", "distortion")


def render(machine: Any, kind: str, view: Camera = VIEW) -> tuple[dict[str, torch.Tensor], dict[str, torch.Tensor]]:
    """Return the images there are, and the gradients of all of them."""
    made = dual_splats(60) if kind == "dual" else random_splats(60, 3 if kind == "single" else 2)
    splats = {name: t.float().to(machine.device).requires_grad_() for name, t in made.items()}
    plain = splat_arguments(splats[name] for name in ("means", "quats", "scales", "opacities", "colors"))
    background = torch.tensor([0.1, 0.5, 0.9], device=machine.device)
    raster: GaussianRaster | SurfelRaster
    with machine.running():
        if kind == "dual":
            light = Reflected(splats["refl_opacities"], splats["refl_colors"], splats["weights"])
            raster = rasterize_gaussians(*plain, view, background, light)
        elif kind == "single":
            raster = rasterize_gaussians(*plain, view, background)
        else:
            raster = rasterize_surfels(*plain, view, background, SurfelOptions(distortion=kind == "distortion"))
        found = {name: getattr(raster, name, None) for name in IMAGES}
        images = {name: image for name, image in found.items() if image is not None}
        generator = torch.Generator().manual_seed(0)
        total = [(image.cpu() * torch.rand(image.shape, generator=generator)).sum() for image in images.values()]
        torch.stack(total).sum().backward()
    gradients = {name: t.grad.cpu() for name, t in splats.items() if t.grad is not None}
    return {name: image.detach().cpu() for name, image in images.items()}, gradients


@pytest.fixture
def worked(monkeypatch: pytest.MonkeyPatch) -> list[list[Band]]:
    """Return the bands of each forward and backward pass, as they come."""
    passes: list[list[Band]] = []
    work_bands = bands.work_bands

    def noted(*arguments: Any) -> Iterator[tuple[Band, Any]]:
        passes.append([])
        for band, result in work_bands(*arguments):
            passes[-1].append(band)
            yield band, result

    monkeypatch.setattr(bands, "work_bands", noted)
    return passes


def check_rows(worked: list[list[Band]]) -> None:
    """Check that each pass has each row of tiles once, in their order, and all pairs."""
    whole = sum(band.pairs for band in worked[0])
    for found in worked:
        assert (found[0].first, found[-1].end) == (0, ROWS)
        assert all(before.end == after.first for before, after in pairwise(found))
        assert sum(band.pairs for band in found) == whole


def check_same(
    expected: tuple[dict[str, torch.Tensor], dict[str, torch.Tensor]],
    found: tuple[dict[str, torch.Tensor], dict[str, torch.Tensor]],
) -> None:
    """Check that pixels are the same to the bit, and gradients but for the order of float32 sums."""
    for name, pixels in expected[0].items():
        assert torch.equal(pixels, found[0][name]), name
    for name, gradient in expected[1].items():
        assert (gradient - found[1][name]).abs().max() <= 1e-5 * gradient.abs().max(), name


@on_each_machine
@pytest.mark.parametrize("kind", KINDS)
def test_bands_change_no_pixel(
    machine: Machine, kind: str, worked: list[list[Band]], monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = render(machine, kind)
    (image,), _ = worked
    worked.clear()
    monkeypatch.setattr(bands, "most_pairs", lambda device, wanted: image.pairs // 3)
    check_same(whole, render(machine, kind))
    assert len(worked) == 2 and all(len(found) > 2 for found in worked)
    check_rows(worked)


class Places:
    """The places where memory may turn out too small while a band is worked: every launch, every operation of torch's.

    refuses: of a place's number since the band was begun, the band, and whether the pass is the backward one. made:
    what torch made there, held weakly, so that a test sees what still lives.
    """

    device = SHIM.device

    def __init__(self, refuses: Callable[[int, Band, bool], bool]) -> None:
        self._refuses = refuses
        self._band: Band | None = None
        self._place = 0
        self.backward, self.raised = False, 0
        self.made: list[weakref.ref[torch.Tensor]] = []

    @contextmanager
    def running(self) -> Iterator[None]:
        """Run operations under the shim within the block, as a Machine does, with these places."""
        with SHIM.running(), use_launcher(_Launcher(self)):
            yield

    def around(self, work: Callable[[Band], Any]) -> Callable[[Band], Any]:
        """Return a band's work, with its places."""

        def counted(band: Band) -> Any:
            self._band, self._place = band, 0
            try:
                with _Operations(self):
                    return work(band)
            finally:
                self._band = None

        return counted

    def reach(self) -> None:
        """Count the next place.

        Raises torch.OutOfMemoryError where it is refused.
        """
        if self._band is None:
            return
        place, self._place = self._place, self._place + 1
        if self._refuses(place, self._band, self.backward):
            self.raised += 1
            raise torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 80.00 GiB")

    def alive(self) -> list[torch.Size]:
        """Return the shapes of what was made and still lives."""
        return [tensor.shape for held in self.made if (tensor := held()) is not None]


class _Operations(TorchDispatchMode):
    def __init__(self, places: Places) -> None:
        TorchDispatchMode.__init__(self)
        self._places = places

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        self._places.reach()
        made = func(*args, **(kwargs or {}))
        self._places.made += [weakref.ref(t) for t in (made if isinstance(made, tuple) else (made,))]
        return made


class _Launcher(ShimLauncher):
    def __init__(self, places: Places) -> None:
        super().__init__()
        self._places = places

    def launch(self, family: str, kernel: str, blocks: int, threads: int, params: ctypes.Structure) -> None:
        self._places.reach()
        super().launch(family, kernel, blocks, threads, params)


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch, worked: list[list[Band]]) -> Callable[..., Places]:
    """Return a function that builds Places.

    When a band is halved, nothing of what was made for it lives, nor the states kept for backward.
    """
    attempt, halves, places = bands._try, bands._halves, list[Places]()

    def with_places(work: Callable[[Band], Any], band: Band) -> Any:
        if not places:  # the rendering to compare with
            return attempt(work, band)
        places[-1].backward = len(worked) == 2
        return attempt(places[-1].around(work), band)

    def halved(*arguments: Any) -> tuple[Band, Band]:
        assert set(places[-1].alive()) <= {torch.Size([60, 16])}, "only sums of the bands before may live"
        return halves(*arguments)

    monkeypatch.setattr(bands, "_try", with_places)
    monkeypatch.setattr(bands, "_halves", halved)

    def make(refuses: Callable[[int, Band, bool], bool]) -> Places:
        worked.clear()
        places[:] = [Places(refuses)]
        return places[-1]

    return make


@pytest.mark.parametrize("backward", [False, True], ids=["forward", "backward"])
@pytest.mark.parametrize("kind", SOME_SLOW)
def test_memory_that_is_too_small_once(
    kind: str, backward: bool, worked: list[list[Band]], short: Callable[..., Places]
) -> None:
    """Check that an image comes out the same where memory is too small once, at each place in turn."""
    whole = render(SHIM, kind)
    for at in count():
        places = short(lambda *now, at=at: now[1].end - now[1].first == ROWS and (now[0], now[2]) == (at, backward))
        found = render(places, kind)
        if not places.raised:
            break
        check_same(whole, found)
        check_rows(worked)
        assert places.raised == 1 and [len(bands) for bands in worked] == ([1, 2] if backward else [2, 2])
    assert at > (4 if backward else 8)


@pytest.mark.parametrize("kind", SOME_SLOW)
def test_memory_that_is_too_small_again_and_again(
    kind: str, worked: list[list[Band]], short: Callable[..., Places]
) -> None:
    """Check that memory may be too small for every band that has too many pairs, at each place in turn.

    Both passes are tried, and backward has less memory.
    """
    whole = render(SHIM, kind)
    pairs = sum(band.pairs for band in worked[0])
    for at in count():
        places = short(lambda *now, at=at: now[0] == at and now[1].pairs > pairs // (4 if now[2] else 3))
        found = render(places, kind)
        if not places.raised:
            break
        check_same(whole, found)
        check_rows(worked)
        assert places.raised > 2 and max(len(bands) for bands in worked) > 2
    assert at > 8


@pytest.mark.parametrize("backward", [False, True], ids=["forward", "backward"])
@pytest.mark.parametrize("kind", KINDS)
def test_a_row_that_memory_does_not_hold_is_refused_with_the_cure(
    kind: str, backward: bool, short: Callable[..., Places]
) -> None:
    places = short(lambda *now: now[0] == 5 and now[2] == backward)
    with pytest.raises(
        GpuError, match=r"memory cannot hold \d+ pairs .* in 1 row.*80\.00 GiB.*fewer or smaller splats"
    ):
        render(places, kind)
    assert places.raised == 3  # 6, 3 and 1 rows


def test_memory_that_does_not_hold_the_counts_is_refused(
    short: Callable[..., Places], monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*arguments: Any) -> Band:
        raise torch.OutOfMemoryError("CUDA out of memory")

    monkeypatch.setattr(bands, "_counted", full)
    with pytest.raises(GpuError, match=r"memory cannot hold \d+ pairs .* in 6 row.*fewer or smaller splats"):
        render(short(lambda *now: True), "single")


def test_a_second_backward_pass_blends_again() -> None:
    """Check that a second backward pass works, though the first gives away what is kept for backward."""
    splats = {name: t.float().requires_grad_() for name, t in random_splats(60, 3).items()}
    names = ("means", "quats", "scales", "opacities", "colors")
    with SHIM.running():
        color = rasterize_gaussians(*splat_arguments(splats[name] for name in names), VIEW, torch.zeros(3)).color
        first = torch.autograd.grad(color.sum(), [splats[name] for name in names], retain_graph=True)
        second = torch.autograd.grad(color.sum(), [splats[name] for name in names])
    assert all(torch.equal(*pair) for pair in zip(first, second, strict=True))


@on_each_machine
def test_more_pairs_in_a_row_than_numbers_are_refused_with_the_cure(
    machine: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bands, "MAX_PAIRS", 3)
    with pytest.raises(
        GpuError, match=r"a row of tiles .* pairs .* more than the limit of 3; .*fewer or smaller splats"
    ):
        render(machine, "single")


@on_each_machine
def test_a_row_is_tried_where_less_memory_is_free_than_it_is_thought_to_need(
    machine: Machine, worked: list[list[Band]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bands, "most_pairs", lambda device, wanted: 0)
    render(machine, "single")
    assert [len(found) for found in worked] == [ROWS, ROWS]


class Gpu:
    """A pretended GPU's memory, in bytes, as torch tells it."""

    total_memory, free, reserved, allocated, asked = 7_200_000, 450_000, 1_000_000, 550_000, 0

    def mem_get_info(self, device: torch.device) -> tuple[int, int]:
        self.asked += 1
        return self.free, self.total_memory


@pytest.fixture
def gpu(monkeypatch: pytest.MonkeyPatch) -> Iterator[Gpu]:
    gpu = Gpu()
    monkeypatch.setattr(torch.cuda, "get_device_properties", lambda device: gpu)
    monkeypatch.setattr(torch.cuda, "mem_get_info", gpu.mem_get_info)
    monkeypatch.setattr(torch.cuda, "memory_reserved", lambda device: gpu.reserved)
    monkeypatch.setattr(torch.cuda, "memory_allocated", lambda device: gpu.allocated)
    bands._total_memory.cache_clear()
    yield gpu
    bands._total_memory.cache_clear()


def test_a_band_is_what_half_of_the_free_memory_holds(gpu: Gpu) -> None:
    """Check that a band has as many pairs, of 450 bytes, as half of the free memory holds.

    What torch's allocator keeps unused is free too.
    """
    device = torch.device("cuda", 0)
    assert bands.most_pairs(device, 1001) == 1000
    gpu.allocated = gpu.reserved
    assert bands.most_pairs(device, 1001) == 500
    gpu.free = 2**50
    assert bands.most_pairs(device, 2**40) == 2**31 - 1


def test_the_driver_is_asked_only_for_many_pairs(gpu: Gpu) -> None:
    """Check that the driver is asked only where pairs need more than a sixteenth of the memory."""
    device = torch.device("cuda", 0)
    assert bands.most_pairs(device, 1000) == 2**31 - 1 and gpu.asked == 0
    bands.most_pairs(device, 1001)
    assert gpu.asked == 1
    assert bands.most_pairs(SHIM.device, 2**40) == 2**31 - 1 and gpu.asked == 1
