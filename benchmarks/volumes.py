"""Time and error of the 3D rasterizer on the kernel scenes:

    python benchmarks/volumes.py ../shared/data/raster s20k_256 s100k_800

Each row is one scene, variant and mode through autograd as training makes it: median milliseconds of 20 runs, and,
where a float64 reference lies beside the scene, the largest error of the image. `single` is one opacity and colour
alone; `dual` is transmitted and reflected colour, weight and depth in one pass. CPU is the time of all threads. Run it
on a machine that is otherwise idle; the modes alternate, so that their ratio holds even where the times drift.
"""

from __future__ import annotations

from functools import partial

import numpy as np
import torch
from rasters import HEADER, RasterScene, arguments, cells, measure, print_row
from torch import Tensor

from mgsr.native import runtime
from mgsr.ops.volumes import Reflected, VolumeOptions, rasterize_volumes


def single(scene: RasterScene) -> list[Tensor]:
    """Colour by one opacity."""
    out = rasterize_volumes(*scene.splats, scene.camera, scene.background, None, VolumeOptions(depth=False))
    return [out.color]


def dual(scene: RasterScene, reflected: Reflected) -> list[Tensor]:
    """Every output that training uses."""
    out = rasterize_volumes(*scene.splats, scene.camera, scene.background, reflected)
    assert out.depth is not None and out.reflected is not None and out.weight is not None
    return [out.color, out.depth, out.reflected, out.weight]


def error(scene: RasterScene) -> str:
    if scene.reference is None:
        return "-"
    return f"{np.abs(single(scene)[0].detach().numpy() - scene.reference).max():.1e}"


def main() -> None:
    args = arguments(__doc__, runtime.isas())
    torch.set_num_threads(1)
    runtime.set_threads(args.threads)
    print_row((*HEADER, "largest error"))
    print_row("---" for _ in range(len(HEADER) + 1))
    for name in args.scenes:
        scene = RasterScene(args.folder, name)
        _, _, _, opacities, colors = scene.splats
        reflected = Reflected(*(t.detach().clone().requires_grad_() for t in (opacities, colors, opacities)))
        modes = {"single": partial(single, scene), "dual": partial(dual, scene, reflected)}
        for isa in args.isa:
            runtime.set_isa(isa)
            for mode, rows in measure(modes, scene, args.runs).items():
                print_row((name, isa, mode, *cells(rows), error(scene)))


if __name__ == "__main__":
    main()
