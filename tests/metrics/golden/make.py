"""Ask the reference program for its figures and store them beside this file.

    DRJIT_LIBLLVM_PATH=.../libLLVM.so python -m tests.metrics.golden.make ../shared

bunny_flash.json: for what tests/metrics/altered.py makes. bunny_flash_floor.json and bunny_flash_hull.json: what
`evaluate.py SCENE --floor` and `--hull` print, for the truth itself and for the masks' visual hull.

It needs what ../shared/tools/evaluate.py needs (mitsuba among others). One run takes a minute.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

from tests.metrics.altered import SCENE, altered_image, altered_mesh, frames, load

HERE = Path(__file__).parent


def main(shared: Path) -> None:
    scene = shared / "data" / "scenes" / SCENE
    with tempfile.TemporaryDirectory() as folder:
        renders = Path(folder)
        altered_mesh(scene).export(renders / "mesh.ply")
        for path in frames(scene):
            Image.fromarray(altered_image(load(path), 1.0)).save(renders / path.name)
            Image.fromarray(altered_image(load(path), 3.0)).save(renders / f"{path.stem}_transmitted.png")
        ask(shared, SCENE, "--mesh", str(renders / "mesh.ply"), "--renders", folder)
    ask(shared, f"{SCENE}_floor", "--floor")
    ask(shared, f"{SCENE}_hull", "--hull")


def ask(shared: Path, name: str, *options: str) -> None:
    """Store what the reference program says of the scene as `name`.json."""
    program, scene = shared / "tools" / "evaluate.py", shared / "data" / "scenes" / SCENE
    command = [sys.executable, str(program), str(scene), *options]
    printed = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    figures = json.loads(printed.splitlines()[-1])
    (HERE / f"{name}.json").write_text(json.dumps(figures, indent=1) + "\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
