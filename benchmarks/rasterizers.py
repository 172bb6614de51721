"""Time of both rasterizers on a GPU, beside gsplat's in the same run where that can be imported.

    python -m benchmarks.rasterizers [--sizes 100k/800 20k/256 500k/1080p 1M/1080p] [--runs 20] [--ours] [--json FILE]

Each row is one size and mode. It has the median milliseconds of forward, of backward and of both through autograd, by
the GPU's own clock, and the peak memory. The modes of one size alternate.

`3d` and `2d` send a gradient to the colour alone, and so do `gsplat 3d` and `gsplat 2d`. `dual` is the 3D branch's two
opacities with weight and depth in one pass. `gsplat 3d twice` is what two passes of gsplat need for the two colours.
`ratio` is the time of both passes over that of the gsplat row of the same kind.

`--ours` leaves gsplat out. `--device cpu` times the kernels of the CPU. The rows of a size are printed and written when
all its modes are done. A mode that fails leaves the others alone.
"""

from __future__ import annotations

import argparse
import json
import math
import statistics
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from mgsr.data.camera import Camera
from mgsr.ops.gaussians import GaussianOptions, Reflected, rasterize_gaussians
from mgsr.ops.surfels import rasterize_surfels

try:
    import gsplat
except ImportError:
    gsplat = None

# The size that targets are set for comes first.
SIZES = ("100k/800", "20k/256", "500k/1080p", "1M/1080p")
Render = Callable[[], list[Tensor]]


@dataclass(frozen=True)
class Scene:
    """A ball of splats: leaves means, quats, scales, opacities, colors; a camera that sees it whole."""

    leaves: tuple[Tensor, ...]
    reflected: Reflected
    camera: Camera
    background: Tensor


@dataclass(frozen=True)
class Row:
    """Median times in ms; peak memory in MiB, None on the processor."""

    size: str
    mode: str
    forward: float
    backward: float
    both: float
    memory: float | None


def make_scene(size: str, device: torch.device) -> Scene:
    """Build a scene whose splats resemble a trained object's in number and size.

    They cover the ball some ten times over.
    """
    count, picture = parse(size)
    width, height = picture
    g = torch.Generator().manual_seed(0)
    means = torch.randn(count, 3, generator=g)
    means = means / means.norm(dim=1, keepdim=True) * torch.rand(count, 1, generator=g).pow(0.2)
    spacing = math.sqrt(4 * math.pi / count)
    tensors = (
        means,
        torch.randn(count, 4, generator=g),
        spacing * (0.3 + torch.rand(count, 3, generator=g)),
        0.05 + 0.9 * torch.rand(count, generator=g),
        torch.rand(count, 3, generator=g),
    )
    leaves = tuple(t.to(device).requires_grad_() for t in tensors)
    light = (torch.rand(count, generator=g), torch.rand(count, 3, generator=g), torch.rand(count, generator=g))
    reflected = Reflected(*(t.to(device).requires_grad_() for t in light))
    focal = 1.25 * height
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]])
    pose = np.eye(4)
    pose[2, 3] = 3.0
    return Scene(leaves, reflected, Camera(K, pose, width, height), torch.zeros(3, device=device))


def parse(size: str) -> tuple[int, tuple[int, int]]:
    """Parse a size: 20k/256 is 20,000 splats on 256 x 256 pixels; 1080p is 1920 x 1080."""
    count, picture = size.split("/")
    number = float(count.rstrip("kM")) * {"k": 1e3, "M": 1e6}.get(count[-1], 1)
    return int(number), (1920, 1080) if picture == "1080p" else (int(picture), int(picture))


def our_modes(scene: Scene) -> dict[str, Render]:
    means, quats, scales, opacities, colors = scene.leaves
    view = (scene.camera, scene.background)

    def gaussians() -> list[Tensor]:
        options = GaussianOptions(depth=False)
        return [rasterize_gaussians(means, quats, scales, opacities, colors, *view, None, options).color]

    def surfels() -> list[Tensor]:
        return [rasterize_surfels(means, quats, scales[:, :2].contiguous(), opacities, colors, *view).color]

    def dual() -> list[Tensor]:
        out = rasterize_gaussians(means, quats, scales, opacities, colors, *view, scene.reflected)
        assert out.reflected is not None and out.weight is not None and out.depth is not None
        return [out.color, out.reflected, out.weight, out.depth]

    return {"3d": gaussians, "2d": surfels, "dual": dual}


def gsplat_modes(scene: Scene) -> dict[str, Render]:
    if gsplat is None or not scene.background.is_cuda:
        return {}
    means, quats, scales, opacities, colors = scene.leaves
    device = means.device
    pose = torch.tensor(scene.camera.cam_from_world, dtype=torch.float32, device=device)[None]
    K = torch.tensor(scene.camera.K, dtype=torch.float32, device=device)[None]
    size = {"width": scene.camera.width, "height": scene.camera.height, "packed": False}

    def gaussians(opacities: Tensor = opacities, colors: Tensor = colors) -> Tensor:
        color: Tensor = gsplat.rasterization(means, quats, scales, opacities, colors, pose, K, **size)[0]
        return color

    def surfels() -> list[Tensor]:
        return [gsplat.rasterization_2dgs(means, quats, scales, opacities, colors[None], pose, K, **size)[0]]

    def twice() -> list[Tensor]:
        return [gaussians(), gaussians(scene.reflected.opacities, scene.reflected.colors)]

    return {"gsplat 3d": lambda: [gaussians()], "gsplat 2d": surfels, "gsplat 3d twice": twice}


def time_once(render: Render, device: torch.device) -> tuple[float, float]:
    """Return the milliseconds of forward and of backward."""
    if device.type == "cpu":
        begin = time.perf_counter()
        images = render()
        middle = time.perf_counter()
        torch.autograd.backward(images, [torch.ones_like(image) for image in images])
        return (middle - begin) * 1e3, (time.perf_counter() - middle) * 1e3
    begin_event, middle_event, end_event = (torch.cuda.Event(enable_timing=True) for _ in range(3))
    torch.cuda.synchronize()
    begin_event.record()
    images = render()
    middle_event.record()
    torch.autograd.backward(images, [torch.ones_like(image) for image in images])
    end_event.record()
    torch.cuda.synchronize()
    return begin_event.elapsed_time(middle_event), middle_event.elapsed_time(end_event)


def measure(size: str, runs: int, device: torch.device, beside: bool = True) -> tuple[list[Row], dict[str, str]]:
    """Return the rows of one size, and what the modes that failed said.

    Two runs of each mode are not counted. beside: whether gsplat is measured too.
    """
    scene = make_scene(size, device)
    modes = our_modes(scene) | (gsplat_modes(scene) if beside else {})
    times: dict[str, list[tuple[float, float]]] = {mode: [] for mode in modes}
    memory: dict[str, float | None] = {}
    failed: dict[str, str] = {}
    for run in range(runs + 2):
        for mode, render in modes.items():
            if mode in failed:
                continue
            if device.type == "cuda":
                torch.cuda.reset_peak_memory_stats()
            try:
                spent = time_once(render, device)
            except Exception as error:  # another program's, too: the other modes go on
                failed[mode] = f"{type(error).__name__}: {str(error).splitlines()[0] if str(error) else ''}"
                continue
            for leaf in (*scene.leaves, *scene.reflected):
                leaf.grad = None
            memory[mode] = torch.cuda.max_memory_allocated() / 2**20 if device.type == "cuda" else None
            if run >= 2:
                times[mode].append(spent)
    return [_row(size, mode, rows, memory[mode]) for mode, rows in times.items() if mode not in failed], failed


def _row(size: str, mode: str, rows: list[tuple[float, float]], memory: float | None) -> Row:
    forward, backward = zip(*rows, strict=True)
    both = [a + b for a, b in rows]
    return Row(size, mode, statistics.median(forward), statistics.median(backward), statistics.median(both), memory)


HEAD = (
    "| size | mode | forward ms | backward ms | both ms | memory MiB | ratio |",
    "|---|---|---|---|---|---|---|",
)


def table_lines(rows: list[Row]) -> Iterator[str]:
    """Return the rows of one size as lines of Markdown, under HEAD."""
    yardsticks = {"3d": "gsplat 3d", "2d": "gsplat 2d", "dual": "gsplat 3d twice"}
    found = {row.mode: row.both for row in rows}
    for row in rows:
        other = found.get(yardsticks.get(row.mode, ""))
        ratio = "" if other is None else f"{row.both / other:.2f}"
        times = f"{row.forward:.3f} | {row.backward:.3f} | {row.both:.3f}"
        memory = "" if row.memory is None else f"{row.memory:.0f}"
        yield f"| {row.size} | {row.mode} | {times} | {memory} | {ratio} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", nargs="+", default=list(SIZES))
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--device", default="cuda")
    parser.add_argument("--ours", action="store_true", help="without gsplat")
    parser.add_argument("--json", type=Path, help="a file that receives each row as a line of JSON")
    args = parser.parse_args()
    if args.device == "cuda" and not torch.cuda.is_available():
        raise SystemExit("torch finds no usable GPU; --device cpu times the CPU")
    without = "" if gsplat is not None and not args.ours else "; without gsplat there are no ratios"
    print(f"\n{gpu(args.device)}, medians of {args.runs}{without}\n", *HEAD, sep="\n", flush=True)
    failures = dict[str, str]()
    for size in args.sizes:
        try:
            rows, failed = measure(size, args.runs, torch.device(args.device), beside=not args.ours)
        except torch.OutOfMemoryError as error:
            rows, failed = [], {"all": str(error).splitlines()[0]}
        print(*table_lines(rows), sep="\n", flush=True)
        failures |= {f"{size} {mode}": error for mode, error in failed.items()}
        if args.json is not None:
            with args.json.open("a") as file:
                file.writelines(json.dumps({"step": "benchmark", **vars(row)}) + "\n" for row in rows)
    print(*(f"\n{mode} failed: {error}" for mode, error in failures.items()), sep="")
    if failures:
        raise SystemExit(1)


def gpu(device: str) -> str:
    """Return the name of the device that is measured."""
    return torch.cuda.get_device_name() if device == "cuda" else "the CPU"


if __name__ == "__main__":
    main()
