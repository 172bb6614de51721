"""Render the scenes of benchmarks/scene_sets.py that are not ready-made.

    python -m benchmarks.render_scenes FOLDER [--scenes NAME...] [--set tuning|judging] [--python PYTHON]

Each becomes FOLDER/NAME, in the layout of ../shared/data/scenes; one that is there already is left alone. PYTHON is
the interpreter of the virtual environment in which ../shared/tools/render_scene.py runs (../shared/data/README.md says
how to make it).
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import trimesh
from skimage.measure import marching_cubes

from benchmarks.scene_sets import COMMON, RENDERED, BenchmarkScene, Cameras, SceneSet, Shape
from mgsr.errors import MgsrError

SHARED = Path(__file__).resolve().parents[1].parent / "shared"
LAST_WRITTEN = "scene_info.json"

# The tool draws the cameras' height above the object's middle from a range; the cone is a range close to the top.
UPPER_HEIGHTS, CONE_HEIGHTS = "(0.05, 0.95)", "(0.7071, 0.999)"


class RenderError(MgsrError):
    """A scene can't be rendered."""

    code = "render_failed"


def main() -> None:
    given = arguments()
    scenes = [scene for scene in RENDERED if chosen(scene, given.scenes, given.set)]
    for number, scene in enumerate(scenes, 1):
        started = time.monotonic()
        made = render(scene, given.folder, given.shared, given.python)
        done = f"rendered in {time.monotonic() - started:.0f} s" if made else "exists already"
        print(f"[{number}/{len(scenes)}] {scene.set} {scene.name}: {done}", flush=True)


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--scenes", nargs="+", choices=[scene.name for scene in RENDERED], metavar="NAME")
    parser.add_argument("--set", type=SceneSet, choices=list(SceneSet))
    parser.add_argument("--python", default=sys.executable)
    parser.add_argument("--shared", type=Path, default=SHARED, help="the folder that has data/meshes and tools")
    return parser.parse_args()


def chosen(scene: BenchmarkScene, names: list[str] | None, scene_set: SceneSet | None) -> bool:
    return (names is None or scene.name in names) and (scene_set is None or scene.set == scene_set)


def render(scene: BenchmarkScene, folder: Path, shared: Path, python: str) -> bool:
    """Render a scene into folder/NAME, which appears when it is complete; False where it was there.

    Raises RenderError when the folder is there without the file that is written last, and when the tool fails.
    """
    out = folder / scene.name
    if (out / LAST_WRITTEN).is_file():
        return False
    if out.exists():
        raise RenderError(
            f"{out}: expected no folder or a complete scene, got a folder without {LAST_WRITTEN}; remove it"
        )
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".rendering_", dir=folder) as workplace:
        work = Path(workplace)
        mesh = source_mesh(scene, shared, work)
        tool = work / "render_scene.py"
        source = (shared / "tools" / "render_scene.py").read_text(encoding="utf-8")
        tool.write_text(tool_for(scene.cameras, source), encoding="utf-8")
        run_tool([python, str(tool), *tool_arguments(scene, mesh, work / scene.name)], scene.name)
        (work / scene.name).rename(out)
    return True


def tool_arguments(scene: BenchmarkScene, mesh: Path, out: Path) -> list[str]:
    """Return what render_scene.py gets for a scene."""
    cams = "full" if scene.cameras == Cameras.FULL else "upper"
    return ["--mesh", str(mesh), "--out", str(out), "--cams", cams, *COMMON.split(), *scene.arguments.split()]


def tool_for(cameras: Cameras, source: str) -> str:
    """Return the renderer's source, with its upper cameras' heights replaced by the cone's where cameras is CONE."""
    if cameras != Cameras.CONE:
        return source
    found = source.count(UPPER_HEIGHTS)
    if found != 1:
        raise RenderError(
            f"render_scene.py: expected {UPPER_HEIGHTS} once, as the heights of its upper cameras, got it {found} "
            "times; adapt UPPER_HEIGHTS in benchmarks/render_scenes.py"
        )
    return source.replace(UPPER_HEIGHTS, CONE_HEIGHTS)


def run_tool(command: list[str], name: str) -> None:
    result = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
    if result.returncode:
        last = "\n".join(result.stdout.strip().splitlines()[-5:])
        raise RenderError(
            f"{name}: expected render_scene.py to end with 0, got {result.returncode}; --python must name an "
            f"interpreter with Mitsuba, see ../shared/data/README.md. Its last lines:\n{last}"
        )


def source_mesh(scene: BenchmarkScene, shared: Path, work: Path) -> Path:
    """Return the file with the scene's mesh; a shape is built and written into work."""
    if not isinstance(scene.source, Shape):
        return shared / "data" / "meshes" / str(scene.source)
    path = work / f"{scene.source}.ply"
    SHAPES[scene.source]().export(path)
    return path


@dataclass(frozen=True)
class Part:
    """A solid part of a shape.

    It is the region where distance, of points x [X,1,1], y [1,Y,1], z [1,1,Z], is below 0; it lies between two corners.
    """

    lower: np.ndarray
    upper: np.ndarray
    distance: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def rod(start: np.ndarray, end: np.ndarray, thickness: float) -> Part:
    """Return a rod: all points within half a thickness of a segment."""
    lower, upper = np.minimum(start, end) - thickness / 2, np.maximum(start, end) + thickness / 2
    return Part(lower, upper, lambda x, y, z: segment_distance((x, y, z), start, end) - thickness / 2)


def turned(start: np.ndarray, end: np.ndarray, thickness: float) -> Part:
    """Return a solid of revolution: the wall that a segment of (radius, z) sweeps around the z axis.

    It is all points within half a thickness of the surface.
    """
    reach = max(start[0], end[0]) + thickness / 2
    low, high = min(start[1], end[1]) - thickness / 2, max(start[1], end[1]) + thickness / 2
    return Part(
        np.array([-reach, -reach, low]),
        np.array([reach, reach, high]),
        lambda x, y, z: segment_distance((np.hypot(x, y), z), start, end) - thickness / 2,
    )


def plate(centre: np.ndarray, sizes: np.ndarray) -> Part:
    """Return a cuboid with its edges along the axes."""

    def distance(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        over = [abs(p - c) - s / 2 for p, c, s in zip((x, y, z), centre, sizes, strict=True)]
        outside = np.sqrt(sum(np.maximum(o, 0) ** 2 for o in over))
        signed: np.ndarray = outside + np.minimum(np.maximum(np.maximum(over[0], over[1]), over[2]), 0)
        return signed

    return Part(centre - sizes / 2, centre + sizes / 2, distance)


def gill(turn: float, reach: float, lower: float, thickness: float, cap: np.ndarray) -> Part:
    """Return a standing plate below a cap, from the z axis outwards at an angle.

    reach: its length; lower: the z of its lower edge; cap: radius, height and the z of the middle of the ellipsoid
    that it ends at.
    """
    ahead, beside = np.array([np.cos(turn), np.sin(turn)]), np.array([-np.sin(turn), np.cos(turn)])
    ends = np.stack([along * ahead + across * beside for along in (0, reach) for across in (-thickness, thickness)])
    box = plate(np.array([reach / 2, 0, (lower + 1) / 2]), np.array([reach, thickness, 1 - lower]))

    def distance(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        along, across = x * ahead[0] + y * ahead[1], x * beside[0] + y * beside[1]
        from_middle = np.sqrt((along / cap[0]) ** 2 + (across / cap[0]) ** 2 + ((z - cap[2]) / cap[1]) ** 2)
        signed: np.ndarray = np.maximum(box.distance(along, across, z), (from_middle - 1) * cap[1])
        return signed

    return Part(np.append(ends.min(axis=0), lower), np.append(ends.max(axis=0), cap[1] + cap[2]), distance)


def segment_distance(points: tuple[np.ndarray, ...], start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Return how far points, given by their coordinates, are from a segment."""
    along = end - start
    place = sum((p - s) * a for p, s, a in zip(points, start, along, strict=True)) / (along @ along)
    place = np.clip(place, 0, 1)
    distances: np.ndarray = np.sqrt(sum((p - s - place * a) ** 2 for p, s, a in zip(points, start, along, strict=True)))
    return distances


def along_line(part: Callable[..., Part], points: np.ndarray, thickness: float) -> list[Part]:
    """Return the parts of a polyline [P,D]."""
    return [part(start, end, thickness) for start, end in pairwise(points)]


def union(parts: list[Part], cell: float) -> trimesh.Trimesh:
    """Return the closed surface of the parts' union, with outward normals, by marching cubes on a grid of that cell.

    A part fills only the grid around it: beyond two cells of the surface, no distance is needed.
    """
    margin = 3 * cell
    origin = np.min([part.lower for part in parts], axis=0) - margin
    top = np.max([part.upper for part in parts], axis=0) + margin
    axes = [np.arange(low, high + cell, cell) for low, high in zip(origin, top, strict=True)]
    field = np.full([len(axis) for axis in axes], margin)
    for part in parts:
        around = [
            slice(*np.searchsorted(axis, [low - 2 * cell, high + 2 * cell]))
            for axis, low, high in zip(axes, part.lower, part.upper, strict=True)
        ]
        near = [axis[window] for axis, window in zip(axes, around, strict=True)]
        distance = part.distance(*np.meshgrid(*near, indexing="ij", sparse=True))
        field[tuple(around)] = np.minimum(field[tuple(around)], distance)
    # A surface through a grid point has triangles without an area: it is kept off by a fiftieth of a cell.
    field = np.where(field < 0, np.minimum(field, -cell / 50), np.maximum(field, cell / 50))
    vertices, faces, _, _ = marching_cubes(field, 0.0, spacing=(cell,) * 3, gradient_direction="descent")
    return trimesh.Trimesh(vertices + origin, faces)


BOWL_THICKNESS, CUP_THICKNESS, HANDLE_THICKNESS = 0.07, 0.05, 0.1
ROD_THICKNESS, SPINDLE_THICKNESS, PLATE_THICKNESS = 0.04, 0.034, 0.03
CAP_THICKNESS, STEM_THICKNESS, GILL_THICKNESS, VASE_THICKNESS = 0.07, 0.34, 0.04, 0.07


def bowl() -> trimesh.Trimesh:
    """Return a deep bowl, half an ellipsoid of height 1.2 and width 1.4."""
    angle = np.linspace(0, np.pi / 2, 49)
    profile = np.stack([0.72 * np.sin(angle), 0.6 - 1.2 * np.cos(angle)], axis=1)
    return union(along_line(turned, profile, BOWL_THICKNESS), cell=0.014)


def cup() -> trimesh.Trimesh:
    """Return a cup of height 1.2 and width 1.1 with a handle on the side of +x."""
    angle = np.linspace(0, np.pi / 2, 7)
    corner = np.stack([0.37 + 0.15 * np.sin(angle), -0.45 - 0.15 * np.cos(angle)], axis=1)
    profile = np.concatenate([[[0.0, -0.6]], corner, [[0.54, 0.6]]])
    turn = np.linspace(-np.pi / 2, np.pi / 2, 25)
    # The ends stay outside the middle of the wall, so that no bump shows inside the cup.
    bow = np.stack([0.59 + 0.36 * np.cos(turn), 0 * turn, 0.34 * np.sin(turn)], axis=1)
    return union(along_line(turned, profile, CUP_THICKNESS) + along_line(rod, bow, HANDLE_THICKNESS), cell=0.012)


def rack() -> trimesh.Trimesh:
    """Return a toast rack, with nine handles.

    It has a base, two standing plates, five arches of rods and a rod along their tops.
    """
    base = plate(np.array([0, 0, -0.4]), np.array([1.4, 0.9, PLATE_THICKNESS]))
    standing = [plate(np.array([x, 0, -0.12]), np.array([PLATE_THICKNESS, 0.5, 0.56])) for x in (-0.14, 0.14)]
    turn = np.linspace(0, np.pi, 13)
    half = np.stack([0.36 * np.cos(turn), 0.15 + 0.36 * np.sin(turn)], axis=1)
    arch = np.concatenate([[[0.36, -0.39]], half, [[-0.36, -0.39]]])
    arches = [np.insert(arch, 0, x, axis=1) for x in (-0.56, -0.28, 0.0, 0.28, 0.56)]
    rods = [part for points in arches for part in along_line(rod, points, ROD_THICKNESS)]
    top = rod(np.array([-0.56, 0, 0.51]), np.array([0.56, 0, 0.51]), ROD_THICKNESS)
    return union([base, *standing, *rods, top], cell=0.0085)


def chair() -> trimesh.Trimesh:
    """Return a chair, with nine handles.

    It has a seat, four splayed legs, a ring of four rungs between them, and a back of six spindles below a rail.
    """
    seat = plate(np.array([0, 0, -0.08]), np.array([0.84, 0.8, PLATE_THICKNESS]))
    corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
    tops, feet = (np.insert(spread * corners, 2, height, axis=1) for spread, height in ((0.34, -0.08), (0.46, -0.85)))
    legs = [rod(top, foot, ROD_THICKNESS) for top, foot in zip(tops, feet, strict=True)]
    middles = 0.45 * tops + 0.55 * feet
    rungs = along_line(rod, np.concatenate([middles, middles[:1]]), ROD_THICKNESS)
    across = np.linspace(-0.35, 0.35, 6)
    spindles = [rod(np.array([x, 0.37, -0.08]), np.array([1.2 * x, 0.47, 0.7]), SPINDLE_THICKNESS) for x in across]
    rail = rod(np.array([-0.46, 0.47, 0.7]), np.array([0.46, 0.47, 0.7]), 2 * ROD_THICKNESS)
    return union([seat, *legs, *rungs, *spindles, rail], cell=0.0085)


def basket() -> trimesh.Trimesh:
    """Return an open basket of 18 staves, two hoops and a flat bottom, with 36 handles."""
    angles = np.arange(18) * 2 * np.pi / 18
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    below, above = (np.insert(radius * directions, 2, height, axis=1) for radius, height in ((0.56, -0.55), (0.8, 0.5)))
    staves = [rod(start, end, ROD_THICKNESS) for start, end in zip(below, above, strict=True)]
    hoops = [np.concatenate([ring, ring[:1]]) for ring in (above, 0.5 * (below + above))]
    bottom = turned(np.array([0.0, -0.55]), np.array([0.56, -0.55]), PLATE_THICKNESS)
    return union([bottom, *staves, *(part for hoop in hoops for part in along_line(rod, hoop, ROD_THICKNESS))], 0.0085)


def lantern() -> trimesh.Trimesh:
    """Return a lantern, with 19 handles: ten bent rods over a round plate, a ring around them and a candle inside."""
    bend = np.linspace(0, np.pi / 2, 9)
    profile = np.stack([0.6 * np.cos(bend), -0.7 + 1.5 * np.sin(bend)], axis=1)
    angles = np.arange(10) * 2 * np.pi / 10
    arches = [np.stack([profile[:, 0] * np.cos(a), profile[:, 0] * np.sin(a), profile[:, 1]], axis=1) for a in angles]
    ring = np.stack([arch[3] for arch in [*arches, arches[0]]])
    rods = [part for points in [*arches, ring] for part in along_line(rod, points, ROD_THICKNESS)]
    bottom = turned(np.array([0.0, -0.7]), np.array([0.6, -0.7]), PLATE_THICKNESS)
    candle = rod(np.array([0, 0, -0.65]), np.array([0, 0, -0.1]), STEM_THICKNESS)
    return union([bottom, candle, *rods], cell=0.0085)


def mushroom() -> trimesh.Trimesh:
    """Return a mushroom: a cap of width 1.8, a stem, and 24 gills that hang between the two."""
    cap = np.array([0.86, 0.6, 0.15])  # radius, height and the z of the rim
    angle = np.linspace(0, np.pi / 2, 33)
    profile = np.stack([cap[0] * np.sin(angle), cap[2] + cap[1] * np.cos(angle)], axis=1)
    stem = rod(np.array([0, 0, -0.85]), np.array([0, 0, 0.54]), STEM_THICKNESS)
    gills = [gill(turn, 0.83, 0.17, GILL_THICKNESS, cap) for turn in np.arange(24) * 2 * np.pi / 24]
    return union([*along_line(turned, profile, CAP_THICKNESS), stem, *gills], cell=0.009)


def vase() -> trimesh.Trimesh:
    """Return a vase of height 1.7, whose neck is half as wide as its belly."""
    height = np.linspace(-0.8, 0.85, 45)
    radius = np.interp(height, [-0.8, -0.3, 0.35, 0.6, 0.85], [0.3, 0.62, 0.36, 0.31, 0.42])
    radius = np.convolve(np.pad(radius, 4, mode="edge"), np.full(9, 1 / 9), mode="valid")
    profile = np.concatenate([[[0.0, height[0]]], np.stack([radius, height], axis=1)])
    return union(along_line(turned, profile, VASE_THICKNESS), cell=0.014)


SHAPES = {
    Shape.BOWL: bowl,
    Shape.CUP: cup,
    Shape.RACK: rack,
    Shape.CHAIR: chair,
    Shape.BASKET: basket,
    Shape.LANTERN: lantern,
    Shape.MUSHROOM: mushroom,
    Shape.VASE: vase,
}

if __name__ == "__main__":
    main()
