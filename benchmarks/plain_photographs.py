"""From photographs alone, or a video of them, to the surface, beside a run that is given the exact cameras.

    python -m benchmarks.plain_photographs SCENE... -o benchmarks/results/plain_photographs.csv --runs FOLDER
        [--inputs photographs video exact] [--preset standard]

Each SCENE is a handheld capture with its truth, such as ../shared/data/handheld/hand_spot. Only its photographs, or a
video of them at two frames a second (H.264), are given to the run; with `exact`, also its cameras. A similarity, fitted
to the cameras' places, then takes the found frame to the true one. The object's surface is scored by
../shared/tools/evaluate_handheld.py. Finished runs in FOLDER are not repeated; rows of other runs stay in the file.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
from dataclasses import dataclass
from enum import StrEnum
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from PIL import Image

from benchmarks.render_scenes import SHARED
from mgsr.bench.csv_rows import read_csv, write_csv
from mgsr.bench.machine import program_commit
from mgsr.config import make_config
from mgsr.pipeline.result_paths import ResultPaths
from mgsr.pipeline.run import run_scene

PICTURES_PER_SECOND = 2


class Input(StrEnum):
    """What a run is given."""

    PHOTOGRAPHS = "photographs"
    VIDEO = "video"
    EXACT = "exact"


@dataclass(frozen=True)
class PlainRow:
    """The scores of one run.

    placed: photographs or frames whose cameras were found. position_mean, position_max: errors of the cameras' places,
    percent of their distance from the object; direction_mean: of their viewing directions, degrees. object_chamfer,
    whole_chamfer: thousandths of the object's radius; foreign_area: percent. mask_iou: the mean intersection over union
    of found and true masks; None for a video, whose frames have no true masks, and where no object was found. cameras,
    seconds: of the search for cameras, and of the whole run.
    """

    scene: str
    input: str
    preset: str
    placed: int
    position_mean: float
    position_max: float
    direction_mean: float
    object_chamfer: float
    whole_chamfer: float
    foreign_area: float
    mask_iou: float | None
    psnr: float
    cameras: float
    seconds: float
    note: str
    commit: str


def main() -> None:
    given = arguments()
    for scene in given.scenes:
        for kind in given.inputs:
            out = given.runs / f"{scene.name}-{kind}-{given.preset}"
            if not (out / "report.json").is_file():
                run_scene(make_input(scene, kind, given.runs), out, make_config(given.preset))
            row = scored(scene, kind, out, given)
            print(row, flush=True)
            others = [old for old in read_csv(given.out, PlainRow) if not same_run(old, row)]
            write_csv(given.out, PlainRow, [*others, row], digits=4)


def same_run(one: PlainRow, other: PlainRow) -> bool:
    """Return whether two rows are of the same scene, input and preset."""
    return (one.scene, one.input, one.preset) == (other.scene, other.input, other.preset)


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="+", type=Path)
    parser.add_argument("-o", dest="out", type=Path, required=True)
    parser.add_argument("--runs", type=Path, required=True)
    parser.add_argument("--inputs", nargs="+", type=Input, default=list(Input))
    parser.add_argument("--preset", default="standard")
    parser.add_argument("--tools", type=Path, default=SHARED / "tools", help="the folder of evaluate_handheld.py")
    parser.add_argument("--note", default="", help="what to say of the runs, such as what else the machine did")
    parser.add_argument("--commit", help="the commit of the program that made the finished runs")
    return parser.parse_args()


def make_input(scene: Path, kind: Input, folder: Path) -> Path:
    """Return what a run reads: the photographs alone, a video of them, or the scene without its truth."""
    target = folder / f"{scene.name}-{kind}"
    target.mkdir(parents=True, exist_ok=True)
    photographs = sorted((scene / "images").iterdir())
    if kind is Input.VIDEO:
        film(target / "walk.mp4", photographs)
        return target / "walk.mp4"
    images = target / "images" if kind is Input.EXACT else target
    images.mkdir(exist_ok=True)
    for path in photographs:
        shutil.copy2(path, images)
    if kind is Input.EXACT:
        shutil.copy2(scene / "transforms.json", target)
    return target


def film(path: Path, photographs: list[Path]) -> None:
    """Write photographs as the frames of a video."""
    import av

    pictures = [np.asarray(Image.open(photograph).convert("RGB")) for photograph in photographs]
    with av.open(str(path), "w") as container:
        stream: Any = container.add_stream("libx264", rate=PICTURES_PER_SECOND, options={"crf": "16", "bf": "0"})
        stream.height, stream.width = pictures[0].shape[:2]
        stream.pix_fmt = "yuv420p"
        for number, picture in enumerate(pictures):
            frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
            frame.pts, frame.time_base = number, Fraction(1, PICTURES_PER_SECOND)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())


def scored(scene: Path, kind: Input, out: Path, given: argparse.Namespace) -> PlainRow:
    """Return the scores of a finished run."""
    report = json.loads((out / "report.json").read_text())
    truth = true_poses(scene)
    found = report["inspection"]["photographs"]
    true = np.stack([truth[photograph_of(photo["name"], kind, list(truth))] for photo in found])
    centers, directions = used_cameras(out, found)
    placing, _, _ = trimesh.registration.procrustes(centers, true[:, :3, 3], reflection=False)
    off = np.linalg.norm(trimesh.transform_points(centers, placing) - true[:, :3, 3], axis=1)
    share = 100 * off / np.linalg.norm(true[:, :3, 3] - middle(scene), axis=1)
    turn = placing[:3, :3] / np.cbrt(np.linalg.det(placing[:3, :3]))
    cosines = (directions @ turn.T * -true[:, :3, 2]).sum(axis=1)
    surface = surface_scores(scene, out, placing, given.tools)
    return PlainRow(
        scene=scene.name,
        input=str(kind),
        preset=given.preset,
        placed=len(found),
        position_mean=float(share.mean()),
        position_max=float(share.max()),
        direction_mean=float(np.degrees(np.arccos(np.clip(cosines, -1, 1))).mean()),
        object_chamfer=1000 * surface["object_chamfer"],
        whole_chamfer=1000 * surface["whole_chamfer"],
        foreign_area=100 * surface["foreign_area"],
        mask_iou=None if kind is Input.VIDEO else mask_overlap(scene, out),
        psnr=report["psnr_test"],
        cameras=report["seconds"].get("cameras", 0.0),
        seconds=report["seconds"]["total"],
        note=given.note,
        commit=given.commit or program_commit(),
    )


def true_poses(scene: Path) -> dict[str, np.ndarray]:
    """Return the camera-to-world matrices [4,4] (OpenGL) by the photographs' names, in their order."""
    frames = json.loads((scene / "transforms.json").read_text())["frames"]
    poses = {Path(frame["file_path"]).stem: np.array(frame["transform_matrix"]) for frame in frames}
    return dict(sorted(poses.items()))


def used_cameras(out: Path, found: list[dict[str, Any]]) -> tuple[np.ndarray, np.ndarray]:
    """Return the centres [N,3] and viewing directions [N,3] of a run's cameras, adjusted ones where there are any.

    found: the photographs of the run's inspection, which comes before the adjustment.
    """
    adjusted = ResultPaths(out).adjusted_cameras
    if not adjusted.is_file():
        return np.array([photo["center"] for photo in found]), np.array([photo["direction"] for photo in found])
    splits = json.loads(adjusted.read_text())
    named = splits["train"] | splits["test"]
    poses = np.array([named[photo["name"]] for photo in found])
    return poses[:, :3, 3], poses[:, :3, 2]


def photograph_of(name: str, kind: Input, names: list[str]) -> str:
    """Return the photograph that a run calls `name`; frames of a video bear their numbers."""
    return names[int(Path(name).stem.rpartition("_")[2])] if kind is Input.VIDEO else Path(name).stem


def middle(scene: Path) -> np.ndarray:
    """Return the middle [3] of the true object's box."""
    return np.asarray(trimesh.load(scene / "truth" / "mesh_gt.ply", process=False).bounds.mean(axis=0))


def surface_scores(scene: Path, out: Path, placing: np.ndarray, tools: Path) -> dict[str, float]:
    """Return the scores of a run's mesh, moved by a similarity [4,4]; the moved mesh stays beside it."""
    mesh = trimesh.load(out / "mesh.ply", process=False)
    mesh.apply_transform(placing)
    mesh.export(out / "mesh_placed.ply")
    tool = [sys.executable, str(tools / "evaluate_handheld.py"), str(scene), "--mesh", str(out / "mesh_placed.ply")]
    answer: dict[str, float] = json.loads(subprocess.run(tool, check=True, capture_output=True, text=True).stdout)
    return answer


def mask_overlap(scene: Path, out: Path) -> float | None:
    """Return the mean intersection over union of a run's masks and the true ones; None where it found no object."""
    overlaps = []
    for path in sorted((out / "masks").glob("**/*.png")):
        found, true = (np.asarray(Image.open(each)) > 127 for each in (path, scene / "truth" / "masks" / path.name))
        overlaps.append((found & true).sum() / (found | true).sum())
    return float(np.mean(overlaps)) if overlaps else None


if __name__ == "__main__":
    main()
