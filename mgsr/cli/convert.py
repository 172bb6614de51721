"""The command `convert`: meshes, splats and scenes from one kind of file to another."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mgsr.cli.options import refusals
from mgsr.data.archive import ARCHIVE_SUFFIXES
from mgsr.export.gltf import UpAxis

SourceArgument = Annotated[
    Path, typer.Argument(metavar="A", help="A mesh (.ply .glb .obj), splats (.ply .spz) or a scene.")
]
TargetArgument = Annotated[
    Path, typer.Argument(metavar="B", help="The new file, whose extension sets its format; for a scene, a new folder.")
]
ScaleOption = Annotated[
    float, typer.Option(help="Multiply all lengths by this, such as 1000 from metres to millimetres.")
]
UpOption = Annotated[
    UpAxis | None, typer.Option(help="The axis of A's frame that points up, if B is a .glb file. The default is y.")
]


def convert(source: SourceArgument, target: TargetArgument, scale: ScaleOption = 1.0, up: UpOption = None) -> None:
    """Convert A to B: a mesh (.ply, .glb, .obj), splats (.ply, .compressed.ply, .spz) or a scene.

    A scene becomes a folder with undistorted photographs, for COLMAP and nerfstudio.
    """
    with refusals():
        from mgsr.export.convert import convert as convert_file
        from mgsr.export.convert import require_kinds
        from mgsr.pipeline.atomic_write import atomic_write, require_file_place
        from mgsr.pipeline.scene_folder import convert_scene

        if source.is_dir() or source.name.lower().endswith(ARCHIVE_SUFFIXES):
            text = convert_scene(source, target, scale, up)
        else:
            require_kinds(source, target, up)
            require_file_place(target)
            with atomic_write(target) as path:
                text = convert_file(source, path, scale, up)
        print(f"{target}: {text}")
