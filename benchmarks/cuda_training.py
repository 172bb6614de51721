"""One training on a card, of a scene that was packed into one file on another machine:

    python benchmarks/cuda_training.py pack ../shared/data/scenes/nefertiti_hdr_800 scene.npz
    python benchmarks/cuda_training.py run scene.npz OUT --preset high [--device cuda] [--profile 100]

`pack` reads the scene and chooses its starting points, which needs OpenImageIO; `pack ball` takes the tests' textured
ball instead. `run` needs torch, numpy, SciPy and plyfile alone. It leaves splats_2d.ply, splats_3d.ply and, where one
was learnt, mirrored_light.npz in OUT, from which `mgsr mesh SCENE -o OUT` makes the mesh anywhere, and training.json:
seconds, iterations, splats, the reflection that was chosen, PSNR of the test views, and, with --profile, the part of an
iteration's wall time in which the card's kernels ran, over that many iterations of a last stage begun anew.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch.profiler import ProfilerActivity
from torch.profiler import profile as record

from mgsr.config import Config, make_config
from mgsr.data.backdrop import backdrop
from mgsr.data.camera import Camera
from mgsr.data.scene import Scene, Similarity, View
from mgsr.export.mirrored_light import write_mirrored_light
from mgsr.export.splats import write_splats
from mgsr.training.evaluate import mean_psnr, surfel_picture, volume_picture
from mgsr.training.parts import StartingPoints
from mgsr.training.plan import make_plan
from mgsr.training.progress import Progress, TrainResult
from mgsr.training.run import Training
from mgsr.training.views import prepare_views

BALL = "ball"


class PackedPoints:
    """Starting points as `Training` takes them."""

    def __init__(self, arrays: dict[str, np.ndarray]) -> None:
        self.positions, self.colors = arrays["positions"], arrays["colors"]
        self.normals = arrays.get("normals")
        self.shiny = bool(arrays["shiny"]) if "shiny" in arrays else None


def pack(path: Path, packed: Path, preset: str) -> None:
    """Everything that training reads of a scene, in one .npz."""
    scene, start = ball() if str(path) == BALL else read(path, make_config(preset))
    arrays: dict[str, Any] = {"positions": start.positions, "colors": start.colors}
    if start.normals is not None:
        arrays["normals"] = start.normals
    if start.shiny is not None:
        arrays["shiny"] = start.shiny
    arrays |= {"scale": scene.user_from_scene.scale, "offset": scene.user_from_scene.offset, "name": scene.name}
    for part, views in (("train", scene.train), ("test", scene.test)):
        arrays[f"{part}_names"] = np.array([view.name for view in views])
        arrays[f"{part}_images"] = np.stack([view.image for view in views])
        arrays[f"{part}_K"] = np.stack([view.camera.K for view in views])
        arrays[f"{part}_poses"] = np.stack([view.camera.cam_from_world for view in views])
        for name, images in (("alphas", [view.alpha for view in views]), ("lit", [view.lit for view in views])):
            if all(image is not None for image in images):
                arrays[f"{part}_{name}"] = np.stack([image for image in images if image is not None])
    np.savez_compressed(packed, **arrays)
    print(f"{packed}: {packed.stat().st_size / 2**20:.1f} MiB")


def read(path: Path, config: Config) -> tuple[Scene, StartingPoints]:
    """A scene and its starting points, as a run has them."""
    from mgsr.data.readers import load_scene
    from mgsr.shading.lighting import lit_scene
    from mgsr.start.starting_points import starting_points

    scene = load_scene(path, config.data)
    most = max(config.train.surfels.max_start, config.train.volumes.max_start)
    start = starting_points(scene, most, config.seed, background=config.train.background)
    return lit_scene(scene, start.lighting if config.train.flash else None), start


def ball() -> tuple[Scene, StartingPoints]:
    """The tests' textured ball, for a machine without any scene."""
    from tests.training.ball import ball_points, ball_scene

    return ball_scene(size=256, train=40, test=4), ball_points(20000)


def unpack(packed: Path) -> tuple[Scene, PackedPoints]:
    """What `pack` wrote."""
    arrays = dict(np.load(packed))
    views = {part: _views(arrays, part) for part in ("train", "test")}
    similarity = Similarity(float(arrays["scale"]), arrays["offset"])
    name = str(arrays["name"])
    return Scene(name, packed, "packed", views["train"], views["test"], None, similarity), PackedPoints(arrays)


def _views(arrays: dict[str, np.ndarray], part: str) -> list[View]:
    images, alphas, lit = (arrays.get(f"{part}_{name}") for name in ("images", "alphas", "lit"))
    assert images is not None
    height, width = images.shape[1:3]
    return [
        View(
            str(name),
            Camera(arrays[f"{part}_K"][i], arrays[f"{part}_poses"][i], width, height),
            images[i],
            None if alphas is None else alphas[i],
            lit=None if lit is None else lit[i],
        )
        for i, name in enumerate(arrays[f"{part}_names"])
    ]


def run(packed: Path, out: Path, config: Config, device: torch.device, profile: int) -> dict[str, Any]:
    """Train, measure, and write the splats and training.json."""
    scene, start = unpack(packed)
    result = Training(scene, start, config, progress=report, device=device).run()
    out.mkdir(parents=True, exist_ok=True)
    for name, model in (("splats_2d.ply", result.surfels), ("splats_3d.ply", result.volumes)):
        if model is not None:
            arrays = {key: tensor.numpy() for key, tensor in model.parameters().items()}
            write_splats(out / name, arrays, scene.user_from_scene)
    if result.light is not None:
        write_mirrored_light(out / "mirrored_light.npz", result.light.maps().numpy())
    facts = measured(scene, result, config, device)
    if profile and device.type == "cuda":
        facts["kernel_share"] = kernel_share(scene, start, as_chosen(config, result), device, profile)
    (out / "training.json").write_text(json.dumps(facts, indent=1))
    return facts


def report(progress: Progress) -> None:
    """One line now and then."""
    if progress.iteration % 1000 == 0 or progress.iteration == progress.total:
        counts = ", ".join(f"{count} {name}" for name, count in progress.counts.items())
        print(
            f"{progress.seconds:7.1f} s  {progress.stage} {progress.iteration}/{progress.total}  {counts}", flush=True
        )


def measured(scene: Scene, result: TrainResult, config: Config, device: torch.device) -> dict[str, Any]:
    """Seconds, iterations, splats, the chosen reflection and the test views' PSNR of each branch."""
    views = prepare_views(scene.test, scene.masked, device=device)
    background = backdrop(scene, config.train.background).color
    surfels = None if result.surfels is None else result.surfels.to(device)
    volumes = None if result.volumes is None else result.volumes.to(device)
    light = None if result.light is None else result.light.to(device)
    splats, psnr = {}, {}
    if surfels is not None:
        splats["surfels"] = len(surfels)
        psnr["surfels"] = mean_psnr(surfel_picture(surfels), views, background)
    if volumes is not None:
        splats["volumes"] = len(volumes)
        psnr["volumes"] = mean_psnr(volume_picture(volumes, surfels, light), views, background)
    return {
        "scene": scene.name,
        "preset": config.preset,
        "device": torch.cuda.get_device_name() if device.type == "cuda" else "cpu",
        "seconds": result.seconds,
        "stages": {stage.name: [stage.iterations, stage.seconds] for stage in result.stages},
        "splats": splats,
        "reflection": {"chosen": result.reflection, "tried": result.tried},
        "psnr": psnr,
    }


def as_chosen(config: Config, result: TrainResult) -> Config:
    """The settings with what the training chose in place of a choice."""
    if result.reflection is None:
        return config
    volumes = replace(config.train.volumes, reflection=result.reflection)
    return replace(config, train=replace(config.train, volumes=volumes))


def kernel_share(scene: Scene, start: PackedPoints, config: Config, device: torch.device, count: int) -> float:
    """The part of the wall time of `count` iterations of the last stage, from its start, in which kernels ran."""
    plan = make_plan(scene, start, config, device)
    stage, background = plan.stages[-1], plan.backdrop.color

    def iterate(i: int) -> None:
        step = stage.compute(stage.views[i % len(stage.views)], background, i)
        torch.stack(list(step.terms.values())).sum().backward()
        for part in stage.trained:
            part.step(0.5)

    for i in range(20):
        iterate(i)
    torch.cuda.synchronize()
    with record(activities=[ProfilerActivity.CUDA]) as recorded:
        begin = time.perf_counter()
        for i in range(count):
            iterate(i)
        torch.cuda.synchronize()
        wall = time.perf_counter() - begin
    return sum(event.self_device_time_total for event in recorded.key_averages()) * 1e-6 / wall


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("action", choices=("pack", "run"))
    parser.add_argument("source", type=Path, help="pack: the scene; run: the packed file")
    parser.add_argument("target", type=Path, help="pack: the file to write; run: the folder of the results")
    parser.add_argument("--preset", default="high")
    parser.add_argument("--set", dest="settings", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--device", default="cuda")
    parser.add_argument("--profile", type=int, default=0, metavar="ITERATIONS")
    args = parser.parse_args()
    if args.action == "pack":
        pack(args.source, args.target, args.preset)
        return
    config = make_config(args.preset, overrides=args.settings)
    print(json.dumps(run(args.source, args.target, config, torch.device(args.device), args.profile), indent=1))


if __name__ == "__main__":
    main()
