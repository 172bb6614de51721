"""The cost of binary and of rough masks.

    python -m benchmarks.masks RENDERED -o benchmarks/results/masks.csv --runs FOLDER --scenes NAME... [--masks KIND...]

RENDERED: see `benchmarks.scene_scores`. Each scene must have training photographs train/*.png with alpha. Its masks are
replaced: by binary ones, or by rough ones, which are binary, and whose contours err by a pixel, alike over about five.
Runs are kept in FOLDER and those that are finished there are not repeated. Rows of other scenes stay in the file.
"""

from __future__ import annotations

import argparse
import json
import shutil
from pathlib import Path

import numpy as np
from PIL import Image
from scipy import ndimage

from benchmarks.evidence.masks import BINARY, EXACT, ROUGH, MaskRow
from benchmarks.scene_scores import find, replace_rows
from benchmarks.scene_sets import SCENES, BenchmarkScene
from mgsr.bench.machine import program_commit
from mgsr.config import make_config
from mgsr.data.mask_error import mask_error
from mgsr.data.readers import load_scene
from mgsr.data.silhouettes import signed_distance
from mgsr.pipeline.run import run_scene

DEVIATIONS = {BINARY: 0.0, ROUGH: 1.0}  # pixels
REACH = 5.0  # pixels over which contours err alike


def main() -> None:
    given = arguments()
    for scene in SCENES:
        if scene.name in given.scenes:
            for masks in given.masks:
                row = measured(scene, find(scene, given.rendered), masks, given.runs, given.preset)
                replace_rows(given.out, MaskRow, [row], ("scene", "masks"))


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rendered", type=Path)
    parser.add_argument("-o", dest="out", type=Path, required=True)
    parser.add_argument("--runs", type=Path, required=True)
    parser.add_argument("--scenes", nargs="+", required=True)
    parser.add_argument("--masks", nargs="+", choices=[EXACT, *DEVIATIONS], default=[EXACT, *DEVIATIONS])
    parser.add_argument("--preset", default="standard")
    return parser.parse_args()


def measured(scene: BenchmarkScene, path: Path, masks: str, runs: Path, preset: str) -> MaskRow:
    """Return the scores of a run with such masks; the run is made unless it is there."""
    out, capture = runs / f"{scene.name}-{masks}", path
    if masks != EXACT:
        capture = runs / f"{scene.name}-{masks}-capture"
        if not capture.is_dir():
            shutil.copytree(path, capture)
            replace_masks(capture, DEVIATIONS[masks], seed=5)
    if not (out / "report.json").is_file():
        run_scene(capture, out, make_config(preset))
    report = json.loads((out / "report.json").read_text())
    return MaskRow(
        scene=scene.name,
        set=scene.set.value,
        masks=masks,
        mask_error=mask_error(load_scene(capture).train),
        chamfer=1000 * report["gt"]["chamfer"],
        normal_error=report["gt"]["normal_error"],
        psnr=report["psnr_test"],
        preset=preset,
        commit=program_commit(),
    )


def replace_masks(scene: Path, deviation: float, seed: int) -> None:
    """Make the masks of the training photographs binary, with contours that err by so many pixels."""
    draw = np.random.default_rng(seed)
    for path in sorted((scene / "train").glob("*.png")):
        pixels = np.array(Image.open(path))
        distance = signed_distance(pixels[..., 3] / 255)
        if deviation:
            noise = ndimage.gaussian_filter(draw.standard_normal(distance.shape), REACH)
            distance = distance + deviation * noise / noise.std()
        pixels[..., 3] = 255 * (distance > 0)
        Image.fromarray(pixels).save(path)


if __name__ == "__main__":
    main()
