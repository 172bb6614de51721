"""Error against the number of Gaussians, by the rule that says where they are added.

    python -m benchmarks.splat_counts SCENE [SCENE ...] -o benchmarks/results/splat_counts.csv [--side 400]
        [--caps 5000 20000] [--device cuda]

The 3D branch is trained alone on each masked SCENE, a folder or a packed scene (see `packed_scenes.py`), without
reflection, once for each cap on its Gaussians and each of `error` (this program's way) and `gradient` (clone and split
as in 3DGS, the plain learning rates). Rows of other scenes stay in the file. A packed scene keeps its size.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import torch

from benchmarks.packed_scenes import unpack
from mgsr.bench.csv_rows import read_csv, write_csv
from mgsr.bench.machine import program_commit
from mgsr.config import Growth, make_config
from mgsr.data.scene import Scene
from mgsr.start.points import StartingPoints
from mgsr.training.evaluate import gaussian_picture, mean_psnr
from mgsr.training.run import Training
from mgsr.training.views import prepare_views

CAPS = (5_000, 10_000, 20_000, 50_000, 100_000, 200_000, 400_000)
START = 10_000  # Gaussians at most


@dataclass(frozen=True)
class CountRow:
    """One training.

    side: pixels of the photographs' longer side; views: training photographs; count: Gaussians that the run ended with,
    at most `cap`; psnr: dB, of the test views; seconds: of training on the device.
    """

    scene: str
    side: int
    views: int
    by: str
    cap: int
    count: int
    psnr: float
    seconds: float
    device: str
    commit: str


def main() -> None:
    """Measure every scene, and write its rows as soon as they are there."""
    given = arguments()
    for path in given.scenes:
        scene, start = read_scene(path, given.side)
        for cap in given.caps:
            for by in Growth:
                row = measured(scene, start, by, cap, given.device)
                print(row, flush=True)
                others = [each for each in read_csv(given.out, CountRow) if key(each) != key(row)]
                write_csv(given.out, CountRow, sorted([*others, row], key=key), digits=5)


def arguments() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", type=Path, nargs="+")
    parser.add_argument("-o", dest="out", type=Path, required=True)
    parser.add_argument("--side", type=int, default=1600)
    parser.add_argument("--caps", type=int, nargs="+", default=CAPS)
    parser.add_argument("--device", type=torch.device, default=torch.device("cpu"))
    return parser.parse_args()


def read_scene(path: Path, side: int) -> tuple[Scene, StartingPoints]:
    """Return a scene, its photographs at most `side` pixels long unless it is packed, and its starting points."""
    if path.suffix == ".npz":
        packed = unpack(path)
        return packed.scene, packed.start
    from mgsr.data.readers import load_scene  # imported here: packed scenes serve machines without its libraries
    from mgsr.start.starting_points import starting_points

    config = make_config(overrides=[f"max_side={side}"])
    scene = load_scene(path, config.data)
    return scene, starting_points(scene, START, config.seed)


def measured(scene: Scene, start: StartingPoints, by: Growth, cap: int, device: torch.device) -> CountRow:
    """Train with the method 3dgs but for its growth, and score the test views."""
    overrides = [
        f"gaussians.densify.by={by}",
        f"gaussians.densify.max_count={cap}",
        f"gaussians.max_start={min(START, cap // 2)}",
    ]
    config = make_config("standard", "3dgs", overrides=overrides)
    result = Training(scene, start, config, device=device).run()
    model = result.model.to(device)
    assert model.gaussians is not None
    views = prepare_views(scene.test, scene.masked, device=device)
    psnr = mean_psnr(gaussian_picture(model), views, scene.backdrop(config.train.background).color)
    side = max(max(view.camera.width, view.camera.height) for view in scene.train)
    name = torch.cuda.get_device_name() if device.type == "cuda" else "cpu"
    return CountRow(
        scene.name,
        side,
        len(scene.train),
        str(by),
        cap,
        len(model.gaussians),
        psnr,
        result.seconds,
        name,
        program_commit(),
    )


def key(row: CountRow) -> tuple[str, int, str, int]:
    """Return what tells rows apart."""
    return row.scene, row.side, row.by, row.cap


if __name__ == "__main__":
    main()
