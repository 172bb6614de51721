"""Error against the number of Gaussians, by what tells where they are added:

    python -m benchmarks.splat_counts SCENE [SCENE ...] -o benchmarks/results/splat_counts.csv [--side 400]

The 3D branch is trained alone on each masked SCENE, without reflection, once for each cap on its Gaussians and each of
`error` (this program's way) and `gradient` (clone and split as in 3DGS, the plain learning rates). Rows of other scenes
stay in the file.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

from mgsr.bench.csv_rows import read_csv, write_csv
from mgsr.bench.machine import program_commit
from mgsr.config import Growth, make_config
from mgsr.data.backdrop import backdrop
from mgsr.data.readers import load_scene
from mgsr.data.scene import Scene
from mgsr.start.starting_points import StartingPoints, starting_points
from mgsr.training.evaluate import mean_psnr, volume_picture
from mgsr.training.run import Training
from mgsr.training.views import prepare_views

CAPS = (5_000, 10_000, 20_000, 50_000, 100_000, 200_000, 400_000)
START = 10_000  # Gaussians at most


@dataclass(frozen=True)
class CountRow:
    """side: pixels of the photographs' longer side at most; count: Gaussians that the run ended with, at most `cap`;
    psnr: dB, of the test views; seconds: of training."""

    scene: str
    side: int
    by: str
    cap: int
    count: int
    psnr: float
    seconds: float
    commit: str


def main() -> None:
    """Measure every scene, and write its rows as soon as they are there."""
    given = arguments()
    for path in given.scenes:
        config = make_config(overrides=[f"max_side={given.side}"])
        scene = load_scene(path, config.data)
        start = starting_points(scene, START, config.seed)
        for cap in CAPS:
            for by in Growth:
                row = measured(scene, start, by, cap, given.side)
                print(row, flush=True)
                others = [each for each in read_csv(given.out, CountRow) if key(each) != key(row)]
                write_csv(given.out, CountRow, sorted([*others, row], key=key), digits=5)


def arguments() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", type=Path, nargs="+")
    parser.add_argument("-o", dest="out", type=Path, required=True)
    parser.add_argument("--side", type=int, default=1600)
    return parser.parse_args()


def measured(scene: Scene, start: StartingPoints, by: Growth, cap: int, side: int) -> CountRow:
    """Train with the method 3dgs but for its growth, and score the test views."""
    overrides = [
        f"volumes.densify.by={by}",
        f"volumes.densify.max_count={cap}",
        f"volumes.max_start={min(START, cap // 2)}",
    ]
    config = make_config("standard", "3dgs", overrides=overrides)
    result = Training(scene, start, config).run()
    assert result.volumes is not None
    views = prepare_views(scene.test, scene.masked)
    psnr = mean_psnr(volume_picture(result.volumes, None, None), views, backdrop(scene, config.train.background).color)
    return CountRow(scene.name, side, str(by), cap, len(result.volumes), psnr, result.seconds, program_commit())


def key(row: CountRow) -> tuple[str, int, str, int]:
    """Return what tells rows apart."""
    return row.scene, row.side, row.by, row.cap


if __name__ == "__main__":
    main()
