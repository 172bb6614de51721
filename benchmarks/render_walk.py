"""Render the frames of a video: one walk around the toy of ../shared/data/handheld/hand_spot, in the same room.

    python -m benchmarks.render_walk FOLDER --python PYTHON [--frames 300] [--samples 8]

FOLDER becomes a handheld capture with its truth, as ../shared/tools/render_handheld.py makes them, but its cameras lie
on one continuous path: a turn near the table, one higher, and one from above, at the pace and with the sway of a hand.
Nothing is blurred by motion. `plain_photographs` makes a video of the frames. PYTHON is the interpreter of the virtual
environment in which the tool runs (../shared/data/README.md says how to make it).
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter1d

from benchmarks.render_scenes import SHARED, RenderError, run_tool

TOOL = "render_handheld.py"
# hand_spot's arguments, of which the cameras' distance is the tool's default.
TOY = "--rotz 30 --material diffuse --w 480 --h 360 --seed 21"
DISTANCE = 2.6

# The tool's own cameras are complete before this statement.
COUNTED = "N = len(poses);"

ELEVATIONS = (18.0, 38.0, 62.0)  # degrees, of the three turns
ENDS = (0.0, 0.42, 0.8, 1.0)  # shares of the frames at which turns begin and end
CLIMB = 0.2  # turns in which the camera rises to the next elevation
SWAYS = 60  # of the hand, in the whole walk
SWAY = np.array([2.0, 0.06, 0.1, 0.1, 0.1, 2.5])  # standard deviations: elevation and roll in degrees, distance and
# the place looked at relative to the distance and the object's radius


def main() -> None:
    given = arguments()
    render_walk(given.folder, given.frames, given.samples, given.shared, given.python)


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--frames", type=int, default=300)
    parser.add_argument("--samples", type=int, default=8, help="paths for a pixel, before the denoising")
    parser.add_argument("--python", default=sys.executable)
    parser.add_argument("--shared", type=Path, default=SHARED, help="the folder that has data/meshes and tools")
    return parser.parse_args()


def render_walk(folder: Path, frames: int, samples: int, shared: Path, python: str) -> None:
    """Render so many frames of the walk. Raises RenderError where the tool is another one, or fails."""
    meshes = shared / "data" / "meshes"
    toy = ["--mesh", str(meshes / "spot.obj"), "--texture", str(meshes / "spot.png"), *TOY.split()]
    with tempfile.TemporaryDirectory(prefix="walk-") as workplace:
        cameras, tool = Path(workplace) / "cameras.npy", Path(workplace) / TOOL
        np.save(cameras, walk(frames))
        tool.write_text(tool_for(cameras, (shared / "tools" / TOOL).read_text(encoding="utf-8")), encoding="utf-8")
        run_tool([python, str(tool), *toy, "--spp", str(samples), "--out", str(folder)], folder.name)


def tool_for(cameras: Path, source: str) -> str:
    """Return the renderer's source with cameras of our own, which a file has as `walk` returns them."""
    if (found := source.count(COUNTED)) != 1:
        raise RenderError(
            f"{TOOL}: expected {COUNTED!r} once, after its cameras, got it {found} times; adapt COUNTED in "
            "benchmarks/render_walk.py"
        )
    ours = f"poses = [look(center + row[:3], center + row[3:6], row[6]) for row in np.load({str(cameras)!r})]\n"
    return source.replace(COUNTED, ours + COUNTED)


def walk(frames: int, seed: int = 0) -> np.ndarray:
    """Return the cameras [F,7] of a walk around an object of radius 1.

    Each row has the camera's place and the place that it looks at, both relative to the object's middle with z up, and
    its roll in radians.
    """
    turns = np.interp(np.linspace(0, 1, frames), ENDS, range(len(ENDS)))
    climbs = np.array([turn + side * CLIMB / 2 for turn in (1, 2) for side in (-1, 1)])
    rng = np.random.default_rng(seed)
    noise = gaussian_filter1d(rng.normal(size=(frames, len(SWAY))), frames / SWAYS, axis=0, mode="nearest")
    sway = SWAY * (noise - noise.mean(axis=0)) / noise.std(axis=0)
    elevation = np.radians(np.interp(turns, climbs, np.repeat(ELEVATIONS, 2)[1:-1]) + sway[:, 0])
    azimuth, distance = 2 * np.pi * turns, DISTANCE * (1 + sway[:, 1])
    across = np.cos(elevation)
    ray = np.stack([across * np.cos(azimuth), across * np.sin(azimuth), np.sin(elevation)], axis=1)
    return np.column_stack([distance[:, None] * ray, sway[:, 2:5], np.radians(sway[:, 5])])


if __name__ == "__main__":
    main()
