"""The options that several commands share, and how they become settings."""

from __future__ import annotations

import atexit
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, NoReturn

import typer

from mgsr.config import METHODS, PRESETS, Up
from mgsr.errors import Cancelled, LostGpuError, MgsrError
from mgsr.pipeline.stop_signals import INTERRUPTED, cleaned_up_after_signals

REFUSED = 2

SceneArgument = Annotated[
    Path, typer.Argument(metavar="SCENE", help="A folder or archive of photographs, or a video (docs/inputs.md).")
]
OutOption = Annotated[Path, typer.Option("--out", "-o", metavar="OUT", help="The folder for the results.")]
PresetOption = Annotated[str, typer.Option(help=f"The amount of work: {', '.join(PRESETS)}.", metavar="PRESET")]
MethodOption = Annotated[str, typer.Option(help=f"The branches to train: {', '.join(METHODS)}.", metavar="METHOD")]
DeviceOption = Annotated[
    str, typer.Option(help="The processor: auto, cpu or cuda (an NVIDIA GPU; see docs/cuda.md).", metavar="DEVICE")
]
SeedOption = Annotated[int, typer.Option(help="The random seed. The same seed gives the same files.", min=0)]
ResumeOption = Annotated[bool, typer.Option("--resume", help="Resume from the checkpoint in OUT, if there is one.")]
TimeBudgetOption = Annotated[
    float | None,
    typer.Option(
        metavar="SECONDS",
        help="The seconds that the whole run should take. MGSR then plans the settings in place of a preset.",
        min=1,
    ),
]
SetOption = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Change one setting (see docs/options.md). Repeat it for several."),
]
FacesOption = Annotated[
    int | None, typer.Option(metavar="FACES", help="Reduce model.glb to this many faces instead of 100,000.")
]
TextureOption = Annotated[
    int | None,
    typer.Option(metavar="TEXELS", help="Make the maps of model.glb this many texels wide, such as 2048."),
]
LodsOption = Annotated[
    int | None, typer.Option(metavar="N", help="Also write N coarser levels of detail: model_lod1.glb and so on.")
]
ObjOption = Annotated[bool, typer.Option("--obj", help="Also write mesh.obj.")]
UsdzOption = Annotated[bool, typer.Option("--usdz", help="Also write model.usdz (pip install 'mgsr\\[usd]').")]
DracoOption = Annotated[
    bool, typer.Option("--draco", help="Also write model_draco.glb, which is compressed (pip install 'mgsr\\[draco]').")
]
UpOption = Annotated[
    Up | None, typer.Option(help="The axis of the capture's frame that points up. It becomes y in .glb files.")
]
ScaleOption = Annotated[
    float | None,
    typer.Option(help="Multiply all written lengths by this, such as 1000 from metres to millimetres."),
]
AsSceneOption = Annotated[
    Path | None,
    typer.Option(
        "--as-scene",
        metavar="FOLDER",
        help="Also write renders and cameras of all views in formats of COLMAP and nerfstudio.",
    ),
]


def output_overrides(
    faces: int | None,
    texture: int | None,
    lods: int | None,
    obj: bool,
    usdz: bool,
    draco: bool,
    up: Up | None,
    scale: float | None,
) -> list[str]:
    """Return what these options mean as settings; none for what was not given."""
    given: dict[str, object] = {"faces": faces, "texture": texture, "lods": lods, "obj": "on" if obj else None}
    given |= {"usdz": "on" if usdz else None, "draco": "on" if draco else None, "up": up, "scale": scale}
    return [f"output.{name}={value}" for name, value in given.items() if value is not None]


@contextmanager
def refusals(resumes: bool = False) -> Iterator[None]:
    """Report an MgsrError as one message on stderr with exit code 2, and a stop with exit code 130.

    Signals end the process after a clean-up. After a LostGpuError the process ends at once. resumes: whether the
    command has --resume.
    """
    try:
        with cleaned_up_after_signals():
            yield
    except Cancelled as stop:
        _say(f"{stop}. To continue, run the same command with --resume.")
        raise typer.Exit(INTERRUPTED) from None
    except KeyboardInterrupt:
        kept = ". The last checkpoint is kept. To continue, run the same command with --resume." if resumes else ""
        _say(f"stopped immediately{kept}")
        raise typer.Exit(INTERRUPTED) from None
    except LostGpuError as error:
        _say(f"error: {error}")
        _end_at_once(REFUSED)
    except MgsrError as error:
        _say(f"error: {error}")
        raise typer.Exit(REFUSED) from None
    except OSError as error:
        _say(f"error: {error}; check the path, its permissions and the free disk space")
        raise typer.Exit(REFUSED) from None


def _end_at_once(code: int) -> NoReturn:
    """End the process without taking down its objects; temporary files go, as at every end."""
    atexit._run_exitfuncs()  # the standard library has no public way to it but the end itself
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


def _say(text: str) -> None:
    print(text, file=sys.stderr)
