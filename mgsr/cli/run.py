"""The command `run`, which `mgsr` and `mgsr-worker` share."""

from __future__ import annotations

import time
from pathlib import Path

from mgsr.cli.options import (
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
    TimeBudgetOption,
    UpOption,
    UsdzOption,
    output_overrides,
    refusals,
)
from mgsr.config import Config, make_config
from mgsr.pipeline.stop_signals import stop_on_signals


def run(
    scene: SceneArgument,
    out: OutOption,
    preset: PresetOption = "standard",
    method: MethodOption = "mgsr",
    device: DeviceOption = "auto",
    seed: SeedOption = 0,
    resume: ResumeOption = False,
    faces: FacesOption = None,
    texture: TextureOption = None,
    lods: LodsOption = None,
    obj: ObjOption = False,
    usdz: UsdzOption = False,
    draco: DracoOption = False,
    up: UpOption = None,
    scale: ScaleOption = None,
    settings: SetOption = None,
    time_budget: TimeBudgetOption = None,
) -> None:
    """Reconstruct SCENE into OUT: mesh, splats, renders of the test views and a report."""
    started_at = time.perf_counter()
    with refusals(resumes=True):
        wishes = [*(settings or []), *output_overrides(faces, texture, lods, obj, usdz, draco, up, scale)]
        wishes += [] if time_budget is None else [f"time_budget={time_budget}"]
        report = _run(scene, out, make_config(preset, method, seed, wishes), device, resume, started_at)
    print(f"mesh   {out / 'mesh.ply'}")
    print(f"report {report.with_suffix('.html')}")


def _run(scene: Path, out: Path, config: Config, device: str, resume: bool, started_at: float) -> Path:
    # Torch and Open3D take seconds to load: a wrong option is refused before.
    from mgsr.pipeline.result_paths import LOG
    from mgsr.pipeline.run import run_scene
    from mgsr.pipeline.run_context import RunControl
    from mgsr.pipeline.run_display import RunDisplay

    with stop_on_signals() as stop, RunDisplay(out / LOG, append=resume) as display:
        return run_scene(scene, out, config, device, RunControl(resume, display, stop, started_at))
