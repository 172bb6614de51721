"""The command `run`, which `mgsr` and `mgsr-worker` share."""

from __future__ import annotations

from pathlib import Path

from mgsr.cli.options import (
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
from mgsr.cli.signals import stop_on_signals
from mgsr.config import make_config


def run(
    scene: SceneArgument,
    out: OutOption,
    preset: PresetOption = "standard",
    method: MethodOption = "mgsr",
    device: DeviceOption = "auto",
    seed: SeedOption = 0,
    resume: ResumeOption = False,
    texture: TextureOption = None,
    obj: ObjOption = False,
    up: UpOption = None,
    scale: ScaleOption = None,
    settings: SetOption = None,
) -> None:
    """Reconstruct SCENE into OUT: mesh, splats, renders of the test views and a report."""
    with refusals():
        overrides = [*(settings or []), *output_overrides(texture, obj, up, scale)]
        report = _run(scene, out, preset, method, device, seed, resume, overrides)
    print(f"mesh   {out / 'mesh.ply'}")
    print(f"report {report.with_suffix('.html')}")


def _run(
    scene: Path, out: Path, preset: str, method: str, device: str, seed: int, resume: bool, settings: list[str]
) -> Path:
    config = make_config(preset, method, seed, settings)
    # Torch and Open3D take seconds to load: a wrong option is refused before.
    from mgsr.cli.console import RunDisplay
    from mgsr.cli.outputs import LOG
    from mgsr.cli.pipeline import run_scene

    with stop_on_signals() as stop, RunDisplay(out / LOG, append=resume) as display:
        return run_scene(scene, out, config, device, resume, display, stop)
