"""The worth of each part that finishes the trained surface.

    python -m benchmarks.finish_parts RENDERED --runs FOLDER -o benchmarks/results/finish_parts.csv [--scenes NAME ...]

FOLDER: the finished runs that `python -m benchmarks.scene_scores` left. For each scene of the tuning set that has one,
the surface is extracted from the run's surfels with all parts, and once without each of them. What Poisson makes of the
surfels, and whether the start is likelier, is found once. Rows of other scenes stay in the file.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

from benchmarks.evidence.surface_parts import ALL, PartRow
from benchmarks.scene_scores import find, replace_rows
from benchmarks.scene_sets import SCENES, SceneSet
from mgsr.bench.machine import program_commit
from mgsr.config import MeshConfig, make_config
from mgsr.data.readers import load_scene
from mgsr.geometry.mesh import Mesh
from mgsr.mesh import extract
from mgsr.mesh.extract import extract_mesh
from mgsr.mesh.surface import ReconstructedMesh
from mgsr.pipeline.evaluation import find_truth, surface_scores
from mgsr.pipeline.rendering import masked_scene, scene_silhouettes, surface_views
from mgsr.pipeline.result_files import at_known_exposures, read_models
from mgsr.pipeline.result_paths import REPORT
from mgsr.shading.photo_set import PhotoSet
from mgsr.start.starting_points import starting_points


@dataclass(frozen=True)
class Parts:
    """The settings of an extraction, and the surface that training began on, None to leave it out."""

    config: MeshConfig
    start: Mesh | None


WITHOUT: dict[str, Callable[[Parts], Parts]] = {
    "the first surface where it fits better": lambda parts: replace(parts, start=None),
    "silhouette correction": lambda parts: replace(parts, config=replace(parts.config, silhouette_smoothing=None)),
    "shape from shading and photometric refinement": lambda parts: replace(
        parts, config=replace(parts.config, max_light_residual=None)
    ),
    "photometric refinement": lambda parts: replace(parts, config=replace(parts.config, photometric_reach=None)),
    "removal of contradicted patches": lambda parts: replace(
        parts, config=replace(parts.config, photometric_residual=None)
    ),
    "local regression of normals": lambda parts: replace(parts, config=replace(parts.config, regression_angle=None)),
    "bilateral normal filtering": lambda parts: replace(parts, config=replace(parts.config, bilateral_angle=None)),
}


def main() -> None:
    given = arguments()
    for scene in SCENES:
        run: Path = given.runs / scene.name
        if scene.set != SceneSet.TUNING or (given.scenes and scene.name not in given.scenes):
            continue
        if not (run / REPORT).is_file():
            print(f"{scene.name}: {run} has no finished run", flush=True)
            continue
        found = measured(find(scene, given.rendered), run)
        replace_rows(given.out, PartRow, found)


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rendered", type=Path)
    parser.add_argument("-o", dest="out", type=Path, required=True)
    parser.add_argument("--runs", type=Path, required=True)
    parser.add_argument("--scenes", nargs="*", default=[])
    return parser.parse_args()


def measured(path: Path, run: Path) -> list[PartRow]:
    """Return a row for the surface with all parts and for the surface without each."""
    config = make_config("standard")
    scene = at_known_exposures(run, load_scene(path, config.data))
    truth, models = find_truth(scene), read_models(run, scene.user_from_scene)
    views, masked = surface_views(models, scene, config), masked_scene(models, scene, config)
    photos = PhotoSet(masked.train, scene_silhouettes(masked))
    whole = Parts(config.mesh, starting_points(scene, 1, config.seed).surface if scene.masked else None)

    def extracted(parts: Parts) -> ReconstructedMesh:
        mesh = extract_mesh(views, parts.config, photos, start=parts.start)
        return mesh.in_frame(scene.user_from_scene.to_user(mesh.vertices))

    rows = []
    with ExitStack() as stack:
        for name in ("_by_poisson", "photographs_prefer_start"):
            stack.enter_context(patch.object(extract, name, found_once(getattr(extract, name))))
        extracted(whole)
        for without, parts in {ALL: whole, **{name: change(whole) for name, change in WITHOUT.items()}}.items():
            began = time.process_time()
            mesh = extracted(parts)
            seconds = time.process_time() - began
            scores = surface_scores(mesh, truth, scene) or {}
            figures = 1000 * scores["chamfer"], scores["normal_error"], seconds
            rows.append(PartRow(path.name, without, *figures, program_commit()))
    return rows


def found_once(find: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function that gives what `find` gave it first, whatever it is called with."""
    results: list[Any] = []

    def give(*given: Any, **more: Any) -> Any:
        if not results:
            results.append(find(*given, **more))
        return results[0]

    return give


if __name__ == "__main__":
    main()
