"""The cost of differing exposures, with and without their correction.

    python -m benchmarks.exposures SCENE... -o benchmarks/results/exposures.csv [--deviation 0.3] [--preset draft]

Each SCENE is a folder whose training photographs are train/*.png (NeRF-synthetic) and that has a mesh_gt.ply. Three
runs: the scene as it is; a copy whose training photographs got exposures of their own (`--deviation` of the logarithm
of light, in whole photographs) with `exposure=keep`; and the copy with the default. PSNR is on the object, after a gain
of each channel, for no program can know at which exposure the test photographs were to be taken.
"""

from __future__ import annotations

import argparse
import json
import shutil
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

from benchmarks.evidence.exposures import EVEN, EVENED, KEPT, ExposureRow
from mgsr.bench.csv_rows import write_csv
from mgsr.bench.machine import program_commit
from mgsr.config import make_config
from mgsr.data.images import linear_to_srgb, srgb_to_linear, to_uint8
from mgsr.pipeline.run import run_scene


def main() -> None:
    given = arguments()
    rows: list[ExposureRow] = []
    for scene in given.scenes:
        with tempfile.TemporaryDirectory() as folder:
            varied = Path(folder) / scene.name
            shutil.copytree(scene, varied)
            expose(varied, given.deviation, given.seed)
            for photographs, path, exposure in (
                (EVEN, scene, "auto"),
                (KEPT, varied, "keep"),
                (EVENED, varied, "auto"),
            ):
                deviation = 0.0 if photographs == EVEN else given.deviation
                rows.append(measured(photographs, path, Path(folder) / "out", given.preset, exposure, deviation))
                print(rows[-1], flush=True)
                write_csv(given.out, ExposureRow, rows, digits=5)


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="+", type=Path)
    parser.add_argument("--deviation", type=float, default=0.3)
    parser.add_argument("--preset", default="draft")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("-o", dest="out", type=Path, required=True)
    return parser.parse_args()


def expose(scene: Path, deviation: float, seed: int) -> None:
    """Multiply each training photograph by its own factor of light; what gets too bright is clipped, as by a camera."""
    draw = np.random.default_rng(seed)
    for path in sorted((scene / "train").glob("*.png")):
        pixels = np.array(Image.open(path))
        light = srgb_to_linear(pixels[..., :3] / 255) * np.exp(draw.normal(0, deviation))
        pixels[..., :3] = to_uint8(255 * linear_to_srgb(np.clip(light, 0, 1)))
        Image.fromarray(pixels).save(path)


def measured(photographs: str, scene: Path, out: Path, preset: str, exposure: str, deviation: float) -> ExposureRow:
    """Return a run's scores."""
    run_scene(scene, out, make_config(preset, overrides=[f"exposure={exposure}"]))
    report = json.loads((out / "report.json").read_text())
    truth = report["gt"]
    return ExposureRow(
        scene=scene.name,
        photographs=photographs,
        deviation=deviation,
        preset=preset,
        psnr=report["psnr_fg_gain_test"],
        chamfer=1000 * truth["chamfer"],
        f_score=truth["f_005"],
        normal_error=truth["normal_error"],
        commit=program_commit(),
    )


if __name__ == "__main__":
    main()
