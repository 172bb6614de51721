"""The command `convert`: meshes and splats from one kind of file to another."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mgsr.cli.options import refusals
from mgsr.export.mesh_files import UpAxis

SourceArgument = Annotated[Path, typer.Argument(metavar="A", help="A mesh (.ply .glb .obj) or splats (.ply .spz).")]
TargetArgument = Annotated[Path, typer.Argument(metavar="B", help="The new file; its name tells the kind.")]
ScaleOption = Annotated[float, typer.Option(help="Multiply all lengths, such as by 1000 from metres to millimetres.")]
UpOption = Annotated[UpAxis, typer.Option(help="Which axis of a mesh's frame points up; a .glb is turned to it.")]


def convert(source: SourceArgument, target: TargetArgument, scale: ScaleOption = 1.0, up: UpOption = UpAxis.Y) -> None:
    """Write the mesh or the splats of A as B: .ply, .glb, .obj; .ply, .compressed.ply, .spz."""
    with refusals():
        from mgsr.cli.whole import whole
        from mgsr.export.convert import convert as convert_file

        with whole(target) as path:
            text = convert_file(source, path, scale, up)
        print(f"{target}: {text}")
