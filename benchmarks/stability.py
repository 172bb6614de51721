"""Whole small trainings of hard scenes, five seeds each, and how much their results differ.

    PYTHONPATH=. python benchmarks/stability.py --keep benchmarks/results/stability.md

The rows take the place of those of the same scenes in the file's table, so that several processes may share the scenes.
Each row is one scene of `hard_scenes.py`: mean, standard deviation and worst of the PSNR of three held-out views, of
both branches; the mean distance of the 2D branch's depth points from the true surface, times 1000 (the ball's radius is
600, a pixel covers 34); how many trainings ended with a number that is not finite, or ended early; and the steps that
the guard undid. Processor time does not depend on what else runs.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from benchmarks.hard_scenes import SCENES, make_scene, make_start, surface_error
from mgsr.config import Config, make_config
from mgsr.data.camera import Camera
from mgsr.errors import TrainingError
from mgsr.gaussians.surfels import SurfelModel
from mgsr.native import runtime
from mgsr.renderers.surfels import render_surfels
from mgsr.training.progress import TrainResult
from mgsr.training.run import Training

HEADER = ("scene", "3D dB", "worst", "2D dB", "worst", "surface", "worst", "failed", "undone", "CPU s")


@dataclass(frozen=True)
class Outcome:
    """One training; psnr and surface are NaN where it failed."""

    gaussians_psnr: float
    surfels_psnr: float
    surface: float
    failed: bool
    undone: int
    seconds: float


def settings(seed: int) -> Config:
    overrides = ["warmup.surfel_iterations=150", "warmup.gaussian_iterations=150", "mutual.iterations=100"]
    overrides += [f"{branch}.densify.every=25" for branch in ("surfels", "gaussians")]
    overrides += ["curve_every=100000", "curve_views=3", "stop_rule=none"]
    return make_config("draft", "mgsr", seed, overrides)


def run(name: str, seed: int) -> Outcome:
    scene, started_at = make_scene(name, seed), time.process_time()
    try:
        result = Training(scene, make_start(name, seed), settings(seed)).run()
    except TrainingError as error:
        print(f"{name}, seed {seed}: {error}")
        return Outcome(np.nan, np.nan, np.nan, True, 0, time.process_time() - started_at)
    assert result.model.surfels is not None
    row = result.curve[-1]
    assert row.psnr_gaussians is not None and row.psnr_surfels is not None
    points = np.concatenate([depth_points(result.model.surfels, view.camera) for view in scene.test])
    failed, seconds = not _finite(result), time.process_time() - started_at
    distance = surface_error(name, points)
    return Outcome(row.psnr_gaussians, row.psnr_surfels, distance, failed, len(result.incidents), seconds)


def depth_points(model: SurfelModel, camera: Camera) -> np.ndarray:
    """Return the points [P,3] in the world that the 2D branch's depth shows a camera."""
    outputs = render_surfels(model, camera)
    depth, alpha = outputs.median_depth.numpy(), outputs.alpha.numpy()
    rows, columns = np.nonzero((alpha > 0.5) & (depth > 0))
    local = np.stack([columns + 0.5, rows + 0.5, np.ones(len(rows))], axis=1) @ np.linalg.inv(camera.K).T
    local *= depth[rows, columns][:, None]
    points: np.ndarray = (local - camera.cam_from_world[:3, 3]) @ camera.cam_from_world[:3, :3]
    return points


def _finite(result: TrainResult) -> bool:
    models = [model for model in (result.model.surfels, result.model.gaussians) if model is not None]
    return all(bool(torch.isfinite(t).all()) for model in models for t in model.parameters().values())


def summary(name: str, outcomes: list[Outcome]) -> tuple[str, ...]:
    gaussians, surfels, surface = (
        np.array([getattr(outcome, field) for outcome in outcomes])
        for field in ("gaussians_psnr", "surfels_psnr", "surface")
    )
    return (
        name,
        f"{gaussians.mean():.2f} ± {gaussians.std():.2f}",
        f"{gaussians.min():.2f}",
        f"{surfels.mean():.2f} ± {surfels.std():.2f}",
        f"{surfels.min():.2f}",
        f"{surface.mean():.1f} ± {surface.std():.1f}",
        f"{surface.max():.1f}",
        str(sum(outcome.failed for outcome in outcomes)),
        str(sum(outcome.undone for outcome in outcomes)),
        f"{np.mean([outcome.seconds for outcome in outcomes]):.1f}",
    )


def line(cells: tuple[str, ...] | list[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def keep(path: Path, row: tuple[str, ...]) -> None:
    """Put a row into the table of a Markdown file, which has all else of its text already."""
    lines = path.read_text(encoding="utf-8").splitlines()
    first = lines.index(line(HEADER)) + 2
    end = next((i for i in range(first, len(lines)) if not lines[i].startswith("|")), len(lines))
    rows = {text.split("|")[1].strip(): text for text in lines[first:end]} | {row[0]: line(row)}
    ordered = [rows[name] for name in SCENES if name in rows]
    path.write_text("\n".join([*lines[:first], *ordered, *lines[end:]]) + "\n", encoding="utf-8")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", default=list(SCENES), metavar="scene", help=", ".join(SCENES))
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--keep", type=Path, help="the file for the table, as in benchmarks/results")
    args = parser.parse_args()
    runtime.set_threads(args.threads)
    print(line(HEADER), line(["---"] * len(HEADER)), sep="\n")
    for name in args.scenes:
        row = summary(name, [run(name, seed) for seed in range(args.seeds)])
        print(line(row), flush=True)
        if args.keep is not None:
            keep(args.keep, row)


if __name__ == "__main__":
    main()
