"""Trainings on a GPU of scenes that were packed elsewhere, whose splats come home for their meshes.

    python -m benchmarks.cuda_training pack ../shared/data/scenes/spot_soft spot_soft.npz --preset standard
    python -m benchmarks.cuda_training pack-all FOLDER [--data ../shared/data]
    python -m benchmarks.cuda_training run spot_soft.npz OUT --preset standard [--device cuda]
    python -m benchmarks.cuda_training home RESULTS OUT [--data ../shared/data]

`pack` reads a scene and does what a run does before it trains (see `packed_scenes.py`), which needs OpenImageIO;
`pack ball` takes the tests' textured ball. `pack-all` packs the scenes of `scripts/gpu_check.sh` and the wheels that
a bare machine lacks, and says how much that is. `run` needs torch, numpy, SciPy, Pillow and plyfile alone. It leaves in
OUT what `mgsr train` would, but for the log, and training.json: seconds, iterations, splats, the reflection that was
chosen, PSNR of the test views, and hashes of what was learnt. `home` takes the splats.zip that the check left in
RESULTS, makes each scene's mesh here, scores both, and prints them beside the CPU's rows of benchmarks/results.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import json
import subprocess
import sys
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from benchmarks.gpu_check.wheels import fetch_wheels
from benchmarks.packed_scenes import Packed, pack, read, unpack
from mgsr.bench.scores import report_scores
from mgsr.config import Config, make_config
from mgsr.data.scene import Scene
from mgsr.export.environment_map import StoredEnvironmentMap, write_environment_map
from mgsr.export.far_origin import about_origin, origin_of_frame
from mgsr.export.splats import write_splats
from mgsr.training.control import TrainingControl
from mgsr.training.evaluate import gaussian_picture, mean_psnr, surfel_picture
from mgsr.training.progress import Progress, TrainResult
from mgsr.training.run import Training
from mgsr.training.views import prepare_views

ROOT = Path(__file__).resolve().parents[1]
DATA = ROOT.parent / "shared" / "data"
CPU_ROWS = ROOT / "benchmarks" / "results" / "runs.csv"
LEARNT = ("splats_2d.ply", "splats_3d.ply", "mirrored_light.npz")
SCORES = ("chamfer", "f_score", "normal_error", "psnr", "surfels", "gaussians", "train_seconds")


@dataclass(frozen=True)
class Checked:
    """A scene that the check trains.

    It has its folder under the data, its preset, and how many of its training photographs are packed, None for all.
    """

    folder: str
    preset: str
    views: int | None = None


# Half of lego's photographs: all of them, packed, would take as much as everything else together.
SCENES = {
    "nefertiti_hdr_800": Checked("scenes/nefertiti_hdr_800", "high"),
    "spot_soft": Checked("scenes/spot_soft", "standard"),
    "bunny_flash": Checked("scenes/bunny_flash", "standard"),
    "lego": Checked("nerf_synthetic/lego", "high", 44),
}


def pack_scene(source: Path, file: Path, preset: str, views: int | None = None) -> None:
    """Read a scene, and write it packed."""
    pack(read(source, make_config(preset), views), file)
    print(f"{file}: {file.stat().st_size / 2**20:.1f} MiB", flush=True)


def pack_all(folder: Path, data: Path) -> None:
    """Pack the scenes that the check trains and the wheels that it needs; what is in the folder already stays."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, scene in SCENES.items():
        if not (folder / f"{name}.npz").is_file():
            pack_scene(data / scene.folder, folder / f"{name}.npz", scene.preset, scene.views)
    for wheel in fetch_wheels(folder):
        print(f"{wheel}: {wheel.stat().st_size / 2**20:.1f} MiB", flush=True)
    total = sum(file.stat().st_size for file in folder.iterdir())
    print(f"{folder}: {total / 2**20:.1f} MiB in all")


def run(
    content: Packed,
    out: Path,
    config: Config,
    device: torch.device,
    deadline: float | None = None,
    should_stop: Callable[[], bool] | None = None,
) -> dict[str, Any]:
    """Train, measure, and write what was learnt and training.json.

    deadline: seconds after which training ends where it is.
    """
    scene, start = content.scene, content.start
    trained = Training(scene, start, config, TrainingControl(report, should_stop, deadline=deadline), device).run()
    out.mkdir(parents=True, exist_ok=True)
    for name, found in content.findings.items():
        (out / name).write_bytes(found)
    write_learnt(out, trained, scene)
    facts = measured(scene, trained, config, device) | {"sha256": digests(out)}
    (out / "training.json").write_text(json.dumps(facts, indent=1))
    return facts


def write_learnt(out: Path, trained: TrainResult, scene: Scene) -> None:
    """Write the branches as splats, and the environment maps, as a run does; what is not there leaves none."""
    for name in LEARNT:
        (out / name).unlink(missing_ok=True)
    origin = origin_of_frame(scene.user_from_scene)
    frame = about_origin(scene.user_from_scene, 1.0, origin)
    low_pass = None if trained.model.gaussians is None else trained.model.gaussians.low_pass
    for name, model, blur in ((LEARNT[0], trained.model.surfels, None), (LEARNT[1], trained.model.gaussians, low_pass)):
        if model is not None:
            arrays = {key: tensor.numpy() for key, tensor in model.parameters().items()}
            write_splats(out / name, arrays, frame, low_pass=blur, origin=origin)
    environment_map = trained.model.environment_map
    if environment_map is not None:
        stored = StoredEnvironmentMap(environment_map.maps().numpy(), environment_map.bounce().numpy())
        write_environment_map(out / LEARNT[2], stored)


def digests(out: Path) -> dict[str, str]:
    """Return a hash of each file of what was learnt."""
    there = [out / name for name in LEARNT if (out / name).is_file()]
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in there}


def report(progress: Progress) -> None:
    """Print one line now and then."""
    if progress.iteration % 500 == 0 or progress.iteration == progress.total:
        counts = ", ".join(f"{count} {name}" for name, count in progress.counts.items())
        psnr = "" if progress.psnr is None else f"  {progress.psnr:.2f} dB"
        print(
            f"{progress.seconds:7.1f} s  {progress.stage} {progress.iteration}/{progress.total}  {counts}{psnr}",
            flush=True,
        )


def measured(scene: Scene, result: TrainResult, config: Config, device: torch.device) -> dict[str, Any]:
    """Return seconds, iterations, splats, the chosen reflection and the test views' PSNR of each branch."""
    views = prepare_views(scene.test, scene.masked, device=device)
    background = scene.backdrop(config.train.background).color
    model, psnr = result.model.to(device), {}
    if model.surfels is not None:
        psnr["surfels"] = mean_psnr(surfel_picture(model.surfels), views, background)
    if model.gaussians is not None:
        psnr["gaussians"] = mean_psnr(gaussian_picture(model), views, background)
    return {
        "scene": scene.name,
        "preset": config.preset,
        "device": torch.cuda.get_device_name() if device.type == "cuda" else "cpu",
        "memory_mib": torch.cuda.max_memory_allocated() / 2**20 if device.type == "cuda" else None,
        "photographs": len(scene.train),
        "seconds": result.seconds,
        "stages": {stage.name: [stage.iterations, stage.seconds, stage.stop_reason] for stage in result.stages},
        "splats": model.counts,
        "reflection": {"chosen": model.reflection, "tried": result.tried},
        "psnr": psnr,
        "incidents": result.incidents,
    }


def home(results: Path, out: Path, data: Path) -> list[str]:
    """Return the table of what the splats of the check's results score here, beside the CPU's rows; as Markdown."""
    with zipfile.ZipFile(results / "splats.zip") as stored:
        stored.extractall(out)
    lines = [f"| scene | preset | device | {' | '.join(SCORES)} |", "|---" * (len(SCORES) + 3) + "|"]
    for folder in sorted(path.parent for path in out.glob("*/training.json") if path.parent.name in SCENES):
        facts = json.loads((folder / "training.json").read_text())
        scene = data / SCENES[folder.name].folder
        rows = [(facts["device"], scores_at_home(scene, folder, facts)), *cpu_rows(facts["scene"], facts["preset"])]
        for device, scores in rows:
            lines.append(f"| {facts['scene']} | {facts['preset']} | {device} | " + " | ".join(cells(scores)) + " |")
    return lines


def scores_at_home(scene: Path, folder: Path, facts: dict[str, Any]) -> dict[str, Any]:
    """Score the splats in a folder, and the mesh that is made of them there."""
    mgsr = [sys.executable, "-m", "program"]
    there = [str(scene), "-o", str(folder), "--device", "cpu"]
    subprocess.run([*mgsr, "mesh", *there, "--preset", facts["preset"]], check=True, cwd=ROOT)
    done = subprocess.run([*mgsr, "evaluate", *there], check=True, cwd=ROOT, stdout=subprocess.PIPE, text=True)
    (folder / "scores.json").write_text(done.stdout)
    splats: dict[str, Any] = facts["splats"]
    return report_scores(json.loads(done.stdout)) | splats | {"train_seconds": facts["seconds"]}


def cpu_rows(scene: str, preset: str) -> list[tuple[str, dict[str, Any]]]:
    """Return the plain runs of a scene on the CPU, each with its commit."""
    with CPU_ROWS.open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if (row["scene"], row["preset"]) == (scene, preset)]
    plain = [row for row in rows if (row["method"], row["variant"], row["device"]) == ("mgsr", "", "cpu")]
    return [(f"CPU, {row['commit']}, seed {row['seed']}", row) for row in plain]


def cells(scores: dict[str, Any]) -> list[str]:
    """Return the table's cells of one row."""
    values = [scores.get(name) for name in SCORES]
    return ["" if value in (None, "") else f"{float(value):.5g}" for value in values]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    actions = parser.add_subparsers(dest="action", required=True)
    packing = actions.add_parser("pack", help="pack a scene into one file")
    packing.add_argument("source", type=Path)
    packing.add_argument("file", type=Path)
    packing.add_argument("--preset", default="high")
    packing.add_argument("--views", type=int, help="the number of training photographs; the default is all")
    everything = actions.add_parser("pack-all", help="pack what scripts/gpu_check.sh needs on a bare machine")
    everything.add_argument("folder", type=Path)
    training = actions.add_parser("run", help="train a packed scene")
    training.add_argument("file", type=Path)
    training.add_argument("out", type=Path)
    training.add_argument("--preset", default="high")
    training.add_argument("--set", dest="settings", action="append", default=[], metavar="KEY=VALUE")
    training.add_argument("--device", default="cuda")
    training.add_argument("--deadline", type=float, metavar="SECONDS")
    homewards = actions.add_parser("home", help="make and score meshes of the splats of a check")
    homewards.add_argument("results", type=Path)
    homewards.add_argument("out", type=Path)
    for action in (everything, homewards):
        action.add_argument("--data", type=Path, default=DATA)
    args = parser.parse_args()
    if args.action == "pack":
        pack_scene(args.source, args.file, args.preset, args.views)
    elif args.action == "pack-all":
        pack_all(args.folder, args.data)
    elif args.action == "run":
        config = make_config(args.preset, overrides=args.settings)
        facts = run(unpack(args.file), args.out, config, torch.device(args.device), args.deadline)
        print(json.dumps(facts, indent=1))
    else:
        print("\n".join(home(args.results, args.out, args.data)))


if __name__ == "__main__":
    main()
