"""`mgsr`: the run and its steps singly. Each step reads what the one before left in OUT."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import typer

from mgsr.cli.bench import bench
from mgsr.cli.convert import convert
from mgsr.cli.demo import demo
from mgsr.cli.options import (
    AsSceneOption,
    DeviceOption,
    MethodOption,
    ObjOption,
    OutOption,
    PresetOption,
    ResumeOption,
    ScaleOption,
    SceneArgument,
    SeedOption,
    SetOption,
    TextureOption,
    UpOption,
    output_overrides,
    refusals,
)
from mgsr.cli.poses import poses
from mgsr.cli.run import run
from mgsr.config import Config, make_config
from mgsr.pipeline.stop_signals import stop_on_signals

app = typer.Typer(
    help="Posed photographs in, surface mesh and clean renders out.",
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)
app.command()(run)
app.command()(demo)
app.command()(poses)
app.command()(convert)
app.command()(bench)


@app.command()
def info(scene: SceneArgument, settings: SetOption = None) -> None:
    """Say what SCENE holds, after every check that a run makes before training."""
    with refusals():
        config = make_config(overrides=settings or [])
        from mgsr.data.readers import load_scene
        from mgsr.pipeline.run_metadata import scene_facts

        found = load_scene(scene, config.data)
        for name, value in scene_facts(found, scene).items():
            print(f"{name:16} {', '.join(map(str, value)) if isinstance(value, list) else value}")


@app.command()
def train(
    scene: SceneArgument,
    out: OutOption,
    preset: PresetOption = "standard",
    method: MethodOption = "mgsr",
    device: DeviceOption = "auto",
    seed: SeedOption = 0,
    resume: ResumeOption = False,
    settings: SetOption = None,
) -> None:
    """Train the branches on SCENE and leave them in OUT as splats_2d.ply and splats_3d.ply."""
    with refusals(resumes=True):
        config = make_config(preset, method, seed, settings or [])
        from mgsr.pipeline.result_files import LOG
        from mgsr.pipeline.run import train_only
        from mgsr.pipeline.run_display import RunDisplay

        with stop_on_signals() as stop, RunDisplay(out / LOG, append=resume) as display:
            train_only(scene, out, config, device, resume, display, stop)


@app.command()
def mesh(
    scene: SceneArgument,
    out: OutOption,
    preset: PresetOption = "standard",
    device: DeviceOption = "auto",
    texture: TextureOption = None,
    obj: ObjOption = False,
    up: UpOption = None,
    scale: ScaleOption = None,
    settings: SetOption = None,
) -> None:
    """Extract mesh.ply and mesh.glb from the splats in OUT, with the preset's settings of the surface."""
    with refusals():
        overrides = [*(settings or []), *output_overrides(texture, obj, up, scale)]
        config = make_config(preset, overrides=overrides)
        from mgsr.data.readers import load_scene
        from mgsr.pipeline.device import pick_device
        from mgsr.pipeline.result_files import at_known_exposures, read_models, write_mesh
        from mgsr.pipeline.run import make_mesh
        from mgsr.start.starting_points import starting_points

        chosen = pick_device(device)
        loaded = at_known_exposures(out, load_scene(scene, config.data))
        # The run held its surface against the one that it began on, which its seed gives again.
        begun_on = starting_points(loaded, 1, config.seed).surface if loaded.masked else None
        surface = make_mesh(read_models(out, loaded).to(chosen.torch), loaded, config, start=begun_on)
        write_mesh(out, surface, loaded, config.output)
        print(f"{out / 'mesh.ply'}: {len(surface.faces)} faces")


@app.command()
def render(
    scene: SceneArgument,
    out: OutOption,
    device: DeviceOption = "auto",
    as_scene: AsSceneOption = None,
    settings: SetOption = None,
) -> None:
    """Render the test views of SCENE from the splats in OUT to OUT/renders/test."""
    with refusals():
        config = make_config(overrides=settings or [])
        from mgsr.data.readers import load_scene
        from mgsr.pipeline.device import pick_device
        from mgsr.pipeline.rendering import render_views, rendered_scene
        from mgsr.pipeline.result_files import RENDERS, as_lit, read_models, write_renders
        from mgsr.pipeline.scene_folder import require_new_folder, write_scene_folder

        chosen = pick_device(device)
        if as_scene is not None:
            require_new_folder(as_scene)
        loaded = as_lit(out, load_scene(scene, config.data))
        models = read_models(out, loaded).to(chosen.torch)
        if as_scene is not None:
            write_scene_folder(as_scene, rendered_scene(models, loaded, config), config.output.scale)
            print(f"{as_scene}: {len(loaded.train) + len(loaded.test)} views and their cameras")
        write_renders(out, list(render_views(models, loaded.test, config)), loaded, config.output)
        print(f"{out / RENDERS}: {len(loaded.test)} views")


@app.command()
def evaluate(scene: SceneArgument, out: OutOption, device: DeviceOption = "auto", settings: SetOption = None) -> None:
    """Score the splats, and the mesh if it is there, of OUT against SCENE; JSON on the standard output."""
    with refusals():
        config = make_config(overrides=settings or [])
        print(json.dumps(_scores(scene, out, device, config), indent=2))


def _scores(scene: Path, out: Path, device: str, config: Config) -> dict[str, Any]:
    from mgsr.data.backdrop import backdrop
    from mgsr.data.readers import load_scene
    from mgsr.pipeline.device import pick_device
    from mgsr.pipeline.evaluation import find_truth, image_scores, surface_scores
    from mgsr.pipeline.rendering import render_views
    from mgsr.pipeline.result_files import MESH, as_lit, at_known_exposures, read_mesh, read_models
    from mgsr.report.data import finite

    chosen = pick_device(device)
    loaded = as_lit(out, at_known_exposures(out, load_scene(scene, config.data)))
    models = read_models(out, loaded).to(chosen.torch)
    behind = backdrop(loaded, config.train.background)
    scores = image_scores(list(render_views(models, loaded.test, config)), loaded, behind.color)
    if (out / MESH).is_file():
        scores |= surface_scores(read_mesh(out), find_truth(loaded), loaded)
    plain: dict[str, Any] = finite(scores)
    return plain


if __name__ == "__main__":
    app()
