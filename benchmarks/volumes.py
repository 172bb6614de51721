"""Time and error of the 3D rasterizer on the kernel scenes:

    python benchmarks/volumes.py ../shared/data/raster s20k_256 s100k_800

Each row is one scene, variant and mode through autograd as training makes it: median and least milliseconds of 20 runs,
and, where a float64 reference lies beside the scene, the largest error of the image. `single` is one opacity and colour
alone; `dual` is transmitted and reflected colour, weight and depth in one pass. Run it on a machine that is otherwise
idle; the modes alternate, so that their ratio holds even where the times drift.
"""

from __future__ import annotations

import argparse
import statistics
import time
from pathlib import Path

import numpy as np
import torch

from mgsr.data.camera import Camera
from mgsr.native import _volumes
from mgsr.ops.volumes import Reflected, VolumeOptions, VolumeRaster, rasterize_volumes

NAMES = ("means", "quats", "scales", "opacities", "rgb")


class Scene:
    """One file of the raster folder: its splats as leaves, its camera and its gradient image."""

    def __init__(self, folder: Path, name: str) -> None:
        data = np.load(folder / f"{name}.npz")
        self.splats = [torch.tensor(data[key]).requires_grad_() for key in NAMES]
        other = (self.splats[3], self.splats[4], self.splats[3])
        self.reflected = Reflected(*(tensor.detach().clone().requires_grad_() for tensor in other))
        size = int(data["width"]), int(data["height"])
        self.camera = Camera(data["K"].astype(float), data["viewmat"].astype(float), *size)
        self.background = torch.tensor(data["background"])
        self.gradient = torch.tensor(data["grad_image"])
        reference = folder / f"ref_{name}.npz"
        self.reference = np.load(reference)["img"] if reference.exists() else None

    def forward(self, dual: bool) -> VolumeRaster:
        reflected = self.reflected if dual else None
        return rasterize_volumes(*self.splats, self.camera, self.background, reflected, VolumeOptions(depth=dual))

    def backward(self, out: VolumeRaster, dual: bool) -> None:
        images, gradients = [out.color], [self.gradient]
        if dual:
            grey = self.gradient[..., 0].contiguous()
            images += [out.depth, out.reflected, out.weight]
            gradients += [grey, self.gradient, grey]
        torch.autograd.backward(images, gradients)

    def error(self) -> str:
        if self.reference is None:
            return "-"
        return f"{np.abs(self.forward(False).color.detach().numpy() - self.reference).max():.1e}"


def measure(scene: Scene, runs: int) -> dict[str, list[tuple[float, float]]]:
    """(forward, backward) milliseconds of each run, by mode."""
    times: dict[str, list[tuple[float, float]]] = {"single": [], "dual": []}
    for run in range(runs + 2):
        for mode, rows in times.items():
            begin = time.perf_counter()
            out = scene.forward(mode == "dual")
            middle = time.perf_counter()
            scene.backward(out, mode == "dual")
            if run >= 2:
                rows.append(((middle - begin) * 1e3, (time.perf_counter() - middle) * 1e3))
    return times


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("scenes", nargs="+")
    parser.add_argument("--runs", type=int, default=20)
    args = parser.parse_args()
    torch.set_num_threads(1)
    print("| scene | variant | mode | forward ms | backward ms | both: median (least) | largest error |")
    print("|---|---|---|---|---|---|---|")
    for name in args.scenes:
        scene = Scene(args.folder, name)
        for isa in _volumes.isas():
            _volumes.set_isa(isa)
            error = scene.error()
            for mode, rows in measure(scene, args.runs).items():
                forward, backward = (statistics.median(column) for column in zip(*rows, strict=True))
                both = [sum(row) for row in rows]
                total = f"{statistics.median(both):.2f} ({min(both):.2f})"
                print(f"| {name} | {isa} | {mode} | {forward:.2f} | {backward:.2f} | {total} | {error} |", flush=True)


if __name__ == "__main__":
    main()
