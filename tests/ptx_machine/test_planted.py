"""Faults planted into a copy of the real kernels are found: a barrier less, a bounds check less."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from mgsr.errors import GpuError
from mgsr.native.cuda.compiler import SOURCES
from tests.cuda import test_gaussians, test_harmonics, test_surfels
from tests.cuda.machines import PTX, Machine
from tests.ops.splat_scenes import camera, random_splats
from tests.ops.test_gaussians import dual_splats
from tests.ops.test_harmonics import scene

Workload = Callable[[Machine], object]
VIEW = camera(18, 17, off_center=False)  # 2 x 2 tiles, most of them cut off by the image's border


def faint(splats: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """Return hundreds of splats on each pixel, so that lists have several batches, and buckets several chunks."""
    for name in splats:
        if name.endswith("opacities"):
            splats[name] *= 0.06
    splats["means"] *= 0.3
    return splats


def gaussians(machine: Machine) -> object:
    return test_gaussians.render(machine, faint(dual_splats(400)), VIEW, dual=True)


def surfels(machine: Machine) -> object:
    return test_surfels.render(machine, faint(random_splats(400, 2)), VIEW)


def harmonics(machine: Machine) -> object:
    coeffs, means, v_rgb = scene(64, 16)
    return test_harmonics.on(machine, coeffs, means, 3, v_rgb)


# What uses a file's barriers, all of which are needed.
WORKLOADS: dict[str, Workload] = {
    "common/buckets_cuda.h": gaussians,
    "harmonics/harmonics.cu": harmonics,
    "surfels/backward_cuda.h": surfels,
    "surfels/blending_cuda.h": surfels,
    "gaussians/backward_cuda.h": gaussians,
    "gaussians/blending_cuda.h": gaussians,
}
BARRIER = re.compile(r"__sync(?:warp|threads)\(\);")


def barriers() -> Iterator[object]:
    """Yield each file with the number of a barrier in it.

    The first of the file that compiles quickest is not slow.
    """
    for file in WORKLOADS:
        for number, _ in enumerate(BARRIER.finditer((SOURCES / "kernels" / file).read_text())):
            quick = (file, number) == ("harmonics/harmonics.cu", 0)
            yield pytest.param(file, number, marks=[] if quick else [pytest.mark.slow])


def planted(folder: Path, file: str, change: Callable[[str], str]) -> Machine:
    """Return a machine for the kernels with one file changed."""
    sources = folder / "native"
    for part in ("kernels", "math"):
        shutil.copytree(SOURCES / part, sources / part)
    path = sources / "kernels" / file
    before = path.read_text()
    assert change(before) != before, f"{file}: nothing there to change"
    path.write_text(change(before))
    return replace(PTX, sources=sources)


def without_barrier(text: str, number: int) -> str:
    place = list(BARRIER.finditer(text))[number]
    return text[: place.start()] + ";" + text[place.end() :]


@pytest.mark.parametrize("workload", dict.fromkeys(WORKLOADS.values()))
def test_the_real_kernels_pass(workload: Workload) -> None:
    workload(PTX)


@pytest.mark.parametrize(("file", "number"), barriers())
def test_a_removed_barrier_is_found(tmp_path: Path, file: str, number: int) -> None:
    machine = planted(tmp_path, file, lambda text: without_barrier(text, number))
    with pytest.raises(GpuError, match=r"(race|uninitialised): .* of shared memory"):
        WORKLOADS[file](machine)


@pytest.mark.slow
@pytest.mark.parametrize("file", ["gaussians/blending_cuda.h", "surfels/blending_cuda.h"])
def test_a_removed_bounds_check_is_found(tmp_path: Path, file: str) -> None:
    """Check that a removed bounds check is found.

    Pixels outside of the image write: out of the tensor, or into another tile's pixels.
    """
    machine = planted(tmp_path, file, lambda text: text.replace("if (pixel.inside(p.tiles)) ", ""))
    with pytest.raises(GpuError, match=r"(out of bounds|race): write of (4 bytes of )?global memory"):
        WORKLOADS[file](machine)
