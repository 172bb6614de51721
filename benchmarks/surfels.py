"""Time of the surfel rasterizer on the kernel scenes, beside the 3D one:

    python benchmarks/surfels.py ../shared/data/raster s20k_256 s100k_800

The scenes' Gaussians are flat: their first two scales make them surfels. Each row is one scene, variant and mode
through autograd as training makes it: median milliseconds of 20 runs. `color` sends a gradient to the colour alone;
`surface` to colour, alpha, both depths and normal; `distortion` renders and differentiates that as well; `volumes` is
the 3D branch with one opacity and colour alone, the yardstick. CPU is the time of all threads. Run it on a machine that
is otherwise idle; the modes alternate, so that their ratio holds even where the times drift.
"""

from __future__ import annotations

from functools import partial

import torch
from rasters import HEADER, RasterScene, arguments, cells, measure, print_row
from torch import Tensor

from mgsr.native import runtime
from mgsr.ops.surfels import SurfelOptions, rasterize_surfels
from mgsr.ops.volumes import VolumeOptions, rasterize_volumes

SURFACE = ("color", "alpha", "depth", "median_depth", "normal")
MODES = {"color": ("color",), "surface": SURFACE, "distortion": (*SURFACE, "distortion")}


def surfels(scene: RasterScene, scales: Tensor, images: tuple[str, ...]) -> list[Tensor]:
    means, quats, _, opacities, colors = scene.splats
    options = SurfelOptions(distortion="distortion" in images)
    out = rasterize_surfels(means, quats, scales, opacities, colors, scene.camera, scene.background, options)
    return [getattr(out, image) for image in images]


def volumes(scene: RasterScene) -> list[Tensor]:
    out = rasterize_volumes(*scene.splats, scene.camera, scene.background, None, VolumeOptions(depth=False))
    return [out.color]


def main() -> None:
    args = arguments(__doc__, runtime.isas())
    torch.set_num_threads(1)
    runtime.set_threads(args.threads)
    print_row(HEADER)
    print_row("---" for _ in HEADER)
    for name in args.scenes:
        scene = RasterScene(args.folder, name)
        scales = scene.splats[2].detach()[:, :2].clone().requires_grad_()
        modes = {mode: partial(surfels, scene, scales, images) for mode, images in MODES.items()}
        for isa in args.isa:
            runtime.set_isa(isa)
            for mode, rows in measure(modes | {"volumes": partial(volumes, scene)}, scene, args.runs).items():
                print_row((name, isa, mode, *cells(rows)))


if __name__ == "__main__":
    main()
