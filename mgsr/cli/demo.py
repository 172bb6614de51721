"""The command `demo`: the example capture that comes with the package, reconstructed."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mgsr.cli.options import DeviceOption, PresetOption, ResumeOption, refusals
from mgsr.cli.run import run
from mgsr.pipeline.example import find_example

DemoOutOption = Annotated[Path, typer.Option("--out", "-o", metavar="OUT", help="The folder for the results.")]


def demo(
    out: DemoOutOption = Path("out/demo"),
    preset: PresetOption = "draft",
    device: DeviceOption = "auto",
    resume: ResumeOption = False,
) -> None:
    """Reconstruct the bundled example, a glossy knot under a flash, and print the paths of the results."""
    with refusals(resumes=True):
        scene = find_example()
    run(scene, out, preset=preset, device=device, resume=resume)
