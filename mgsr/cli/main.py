"""The program `mgsr`: a whole run, or its steps one by one. Each step reads the results of the step before from OUT."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Annotated

import typer

from mgsr.cli.bench import bench
from mgsr.cli.convert import convert
from mgsr.cli.demo import demo
from mgsr.cli.options import (
    AsSceneOption,
    DeviceOption,
    DracoOption,
    FacesOption,
    LodsOption,
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
    UsdzOption,
    output_overrides,
    refusals,
)
from mgsr.cli.poses import poses
from mgsr.cli.run import run
from mgsr.config import make_config
from mgsr.pipeline.stop_signals import stop_on_signals

app = typer.Typer(
    help="Turn photographs into a surface mesh and clean renders.",
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
    """Read SCENE as a run does, and print its contents. What a run would refuse is refused."""
    with refusals():
        config = make_config(overrides=settings or [])
        from mgsr.pipeline.run_metadata import capture_facts

        for name, value in capture_facts(scene, config).items():
            print(f"{name:16} {', '.join(map(str, value)) if isinstance(value, list) else value}")


@app.command()
def check(
    scene: SceneArgument,
    as_json: Annotated[bool, typer.Option("--json", help="Write everything as JSON.")] = False,
    settings: SetOption = None,
) -> None:
    """Inspect SCENE before training: what is wrong, in which photographs, and what to do. Exit code 1 on errors."""
    with refusals():
        config = make_config(overrides=settings or [])
        from mgsr.data.readers import load_scene
        from mgsr.inspection.findings import Severity
        from mgsr.inspection.inspect import inspect_scene
        from mgsr.pipeline.run_metadata import scene_line
        from mgsr.pipeline.scene_check import summary

        found = load_scene(scene, config.data, options=config.expert.data)
        inspection = inspect_scene(found, options=config.expert.inspection)
        if as_json:
            print(json.dumps(inspection.to_json(), indent=2))
        else:
            print(scene_line(found))
            for finding in inspection.findings:
                print(finding.line)
            print(summary(inspection))
    raise typer.Exit(1 if inspection.worst is Severity.ERROR else 0)


@app.command()
def estimate(
    scene: SceneArgument,
    method: MethodOption = "mgsr",
    device: DeviceOption = "auto",
    as_json: Annotated[bool, typer.Option("--json", help="Write everything as JSON.")] = False,
    settings: SetOption = None,
) -> None:
    """Print how long a run on SCENE takes on this machine, and how much memory it needs, at each preset."""
    with refusals():
        config = make_config(method=method, overrides=[*(settings or []), "check=off"])
        from mgsr.pipeline.estimate import estimate_line, estimate_presets

        estimates = estimate_presets(scene, config, device)
        if as_json:
            print(json.dumps([asdict(each) for each in estimates], indent=2))
        else:
            print("\n".join(map(estimate_line, estimates)))


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
    """Train the branches on SCENE, and write them to OUT as splats_2d.ply and splats_3d.ply."""
    with refusals(resumes=True):
        config = make_config(preset, method, seed, settings or [])
        from mgsr.pipeline.result_paths import LOG
        from mgsr.pipeline.run import train_only
        from mgsr.pipeline.run_context import RunControl
        from mgsr.pipeline.run_display import RunDisplay

        with stop_on_signals() as stop, RunDisplay(out / LOG, append=resume) as display:
            train_only(scene, out, config, device, RunControl(resume, display, stop))


@app.command()
def mesh(
    scene: SceneArgument,
    out: OutOption,
    preset: PresetOption = "standard",
    device: DeviceOption = "auto",
    faces: FacesOption = None,
    texture: TextureOption = None,
    lods: LodsOption = None,
    obj: ObjOption = False,
    usdz: UsdzOption = False,
    draco: DracoOption = False,
    up: UpOption = None,
    scale: ScaleOption = None,
    settings: SetOption = None,
) -> None:
    """Extract mesh.ply and model.glb from the splats in OUT, with the preset's settings for the mesh."""
    with refusals():
        overrides = [*(settings or []), *output_overrides(faces, texture, lods, obj, usdz, draco, up, scale)]
        config = make_config(preset, overrides=overrides)
        from mgsr.pipeline.single_steps import mesh_again

        surface = mesh_again(scene, out, config, device)
        print(f"{out / 'mesh.ply'}: {len(surface.faces)} faces")


@app.command()
def render(
    scene: SceneArgument,
    out: OutOption,
    device: DeviceOption = "auto",
    as_scene: AsSceneOption = None,
    settings: SetOption = None,
) -> None:
    """Render the test views of SCENE from the splats in OUT, and write them to OUT/renders/test."""
    with refusals():
        config = make_config(overrides=settings or [])
        from mgsr.pipeline.result_paths import RENDERS
        from mgsr.pipeline.single_steps import render_again

        rendered = render_again(scene, out, config, device, as_scene)
        if as_scene is not None:
            print(f"{as_scene}: {len(rendered.train) + len(rendered.test)} views with their cameras")
        print(f"{out / RENDERS}: {len(rendered.test)} views")


@app.command()
def evaluate(scene: SceneArgument, out: OutOption, device: DeviceOption = "auto", settings: SetOption = None) -> None:
    """Score the splats and any mesh in OUT against SCENE, and print the scores as JSON."""
    with refusals():
        config = make_config(overrides=settings or [])
        from mgsr.pipeline.single_steps import score_again

        print(json.dumps(score_again(scene, out, config, device), indent=2))


if __name__ == "__main__":
    app()
