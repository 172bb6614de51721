"""Time and error of the surfel rasterizer on the kernel scenes, beside the 3D one:

    python benchmarks/surfels.py ../shared/data/raster s20k_256 s100k_800

The scenes' Gaussians are flat: their first two scales make them surfels. Each row is one scene, variant and mode
through autograd as training makes it: median and least milliseconds of 20 runs. `color` sends a gradient to the colour
alone; `surface` to colour, alpha, both depths and normal; `distortion` renders and differentiates that as well;
`volumes` is the 3D branch with one opacity and colour alone, the yardstick. Run it on a machine that is otherwise idle;
the modes alternate, so that their ratio holds even where the times drift.
"""

from __future__ import annotations

import argparse
import statistics
import time
from pathlib import Path

import numpy as np
import torch

from mgsr.data.camera import Camera
from mgsr.native import _surfels, _volumes
from mgsr.ops.surfels import SurfelOptions, rasterize_surfels
from mgsr.ops.volumes import VolumeOptions, rasterize_volumes

NAMES = ("means", "quats", "scales", "opacities", "rgb")
MODES = {
    "color": ("color",),
    "surface": ("color", "alpha", "depth", "median_depth", "normal"),
    "distortion": ("color", "alpha", "depth", "median_depth", "normal", "distortion"),
    "volumes": ("color",),
}


class Scene:
    """One file of the raster folder: its splats as leaves, its camera and its gradient images."""

    def __init__(self, folder: Path, name: str) -> None:
        data = np.load(folder / f"{name}.npz")
        self.volumes = [torch.tensor(data[key]).requires_grad_() for key in NAMES]
        self.surfels = [torch.tensor(data[key]).requires_grad_() for key in NAMES]
        self.surfels[2] = torch.tensor(data["scales"][:, :2].copy()).requires_grad_()
        size = int(data["width"]), int(data["height"])
        self.camera = Camera(data["K"].astype(float), data["viewmat"].astype(float), *size)
        self.background = torch.tensor(data["background"])
        gradient = torch.tensor(data["grad_image"])
        self.gradients = {3: gradient, 2: gradient[..., 0].contiguous()}

    def images(self, mode: str) -> list[torch.Tensor]:
        if mode == "volumes":
            out = rasterize_volumes(*self.volumes, self.camera, self.background, None, VolumeOptions(depth=False))
            return [out.color]
        options = SurfelOptions(distortion=mode == "distortion")
        raster = rasterize_surfels(*self.surfels, self.camera, self.background, options)
        return [getattr(raster, image) for image in MODES[mode]]

    def backward(self, images: list[torch.Tensor]) -> None:
        torch.autograd.backward(images, [self.gradients[image.ndim] for image in images])


def measure(scene: Scene, runs: int) -> dict[str, list[tuple[float, float]]]:
    """(forward, backward) milliseconds of each run, by mode."""
    times: dict[str, list[tuple[float, float]]] = {mode: [] for mode in MODES}
    for run in range(runs + 2):
        for mode, rows in times.items():
            begin = time.perf_counter()
            images = scene.images(mode)
            middle = time.perf_counter()
            scene.backward(images)
            if run >= 2:
                rows.append(((middle - begin) * 1e3, (time.perf_counter() - middle) * 1e3))
    return times


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("scenes", nargs="+")
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--isa", nargs="*", default=_surfels.isas(), help="variants to measure; all by default")
    parser.add_argument("--threads", type=int, default=0, help="0: all processors")
    args = parser.parse_args()
    torch.set_num_threads(1)
    print("| scene | variant | mode | forward ms | backward ms | both: median (least) |")
    print("|---|---|---|---|---|---|")
    for name in args.scenes:
        scene = Scene(args.folder, name)
        for isa in args.isa:
            for family in (_surfels, _volumes):
                family.set_isa(isa)
                family.set_threads(args.threads)
            for mode, rows in measure(scene, args.runs).items():
                forward, backward = (statistics.median(column) for column in zip(*rows, strict=True))
                both = [sum(row) for row in rows]
                total = f"{statistics.median(both):.2f} ({min(both):.2f})"
                print(f"| {name} | {isa} | {mode} | {forward:.2f} | {backward:.2f} | {total} |", flush=True)


if __name__ == "__main__":
    main()
