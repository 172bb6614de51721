"""The command `poses`: cameras for photographs that have none."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mgsr.cli.options import refusals

PhotosArgument = Annotated[
    Path, typer.Argument(metavar="PHOTOS", help="A folder or archive of photographs, or a video.", exists=True)
]
SceneOption = Annotated[Path, typer.Option("--out", "-o", metavar="SCENE", help="The folder for the new scene.")]
PosesSeedOption = Annotated[int, typer.Option("--seed", help="The seed of COLMAP's random samples.", min=0)]
CameraPerImageOption = Annotated[
    bool,
    typer.Option("--camera-per-image", help="Estimate one lens per photograph, for zoomed, cropped or mixed captures."),
]


def poses(
    photos: PhotosArgument, out: SceneOption, seed: PosesSeedOption = 0, camera_per_image: CameraPerImageOption = False
) -> None:
    """Find the cameras of PHOTOS with COLMAP, and write both as a SCENE for `mgsr run`."""
    with refusals():
        from mgsr.data.find_poses import find_poses

        for note in find_poses(photos, out, seed, camera_per_image=camera_per_image):
            print(note)
        print(f"scene  {out}")
