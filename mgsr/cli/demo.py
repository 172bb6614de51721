"""The command `demo`: the example capture that comes with the package, reconstructed."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mgsr.cli.options import DeviceOption, PresetOption, ResumeOption, refusals
from mgsr.cli.run import run
from mgsr.pipeline.example import find_example

DemoOutOption = Annotated[Path, typer.Option("--out", "-o", metavar="OUT", help="The folder of the results.")]


def demo(
    out: DemoOutOption = Path("out/demo"),
    preset: PresetOption = "draft",
    device: DeviceOption = "auto",
    resume: ResumeOption = False,
) -> None:
    """Reconstruct the example that comes with MGSR, a glossy knot under a flash, and say where the results lie."""
    with refusals(resumes=True):
        scene = find_example()
    run(scene, out, preset=preset, device=device, resume=resume)
