"""The worth of each part of finding the starting surface.

    python -m benchmarks.start_parts RENDERED -o benchmarks/results/start_parts.csv [--scenes NAME ...]

For each scene of the tuning set, the surface that training begins on is found with all parts, and once without each of
them. Stereo's search is the same in all, and made once. Rows of other scenes stay in the file.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from benchmarks.evidence.surface_parts import ALL, PartRow
from benchmarks.scene_scores import find, replace_rows, scores_of
from benchmarks.scene_sets import SCENES, SceneSet
from mgsr.bench.machine import program_commit
from mgsr.config import ExpertConfig, make_config
from mgsr.config.expert import StartConfig
from mgsr.data.hull import carve
from mgsr.data.readers import load_scene
from mgsr.data.silhouettes import view_silhouettes
from mgsr.geometry.mesh import Mesh
from mgsr.geometry.raycast import RayCaster
from mgsr.pipeline.evaluation import find_truth
from mgsr.shading.light_estimate import LightEstimate
from mgsr.shading.photo_set import PhotoSet
from mgsr.start import masked_surface
from mgsr.start.masked_surface import find_surface
from mgsr.stereo.patch_match import DepthMap, match_views
from mgsr.stereo.photographs import StereoPhotographs


@dataclass(frozen=True)
class Part:
    """A start without one of its parts: functions of `masked_surface` that are replaced, and settings."""

    replaced: dict[str, Any] = field(default_factory=dict)
    settings: tuple[str, ...] = ()

    def options(self) -> ExpertConfig:
        """Return the options of the algorithms with the part's settings."""
        return make_config(overrides=self.settings).expert


def _unmoved(mesh: Mesh, *rest: Any, **more: Any) -> Mesh:
    return mesh


def _nothing(*rest: Any) -> Mesh:
    return Mesh(np.empty((0, 3)), np.empty((0, 3), np.int64))


PARTS: dict[str, Part] = {
    "stereo": Part({"fuse_roughly": _nothing}),
    "stereo on photographs of half the size": Part({"weigh_gaps": lambda coarse, fine: [0 * each for each in coarse]}),
    "total variation": Part(settings=("fusion.variation=1e-6",)),
    "the hull where it fits better": Part(settings=("max_hull_residual=0", "disbelieved=1e9")),
    "shape from shading": Part({"estimate_light": lambda *given: LightEstimate(), "shape_from_shading": _unmoved}),
    "photometric refinement": Part({"refine_photometrically": _unmoved}),
}


def main() -> None:
    given = arguments()
    for scene in SCENES:
        if scene.set != SceneSet.TUNING or (given.scenes and scene.name not in given.scenes):
            continue
        found = measured(find(scene, given.rendered))
        replace_rows(given.out, PartRow, found)


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rendered", type=Path)
    parser.add_argument("-o", dest="out", type=Path, required=True)
    parser.add_argument("--scenes", nargs="*", default=[])
    return parser.parse_args()


def measured(path: Path) -> list[PartRow]:
    """Return a row for the start with all parts and for the start without each."""
    scene = load_scene(path, make_config("standard").data)
    silhouettes, truth, rows = view_silhouettes(scene.train, StartConfig().mask_side), find_truth(scene), []
    hull = carve(silhouettes, np.zeros(3), 1.05, StartConfig().resolution)
    photos = PhotoSet.of_scene(scene, silhouettes)

    maps: dict[int, list[DepthMap]] = {}

    def once(photographs: StereoPhotographs, caster: RayCaster, seed: int, *rest: Any) -> list[DepthMap]:
        width = photographs.cameras[0].width
        if width not in maps:
            maps[width] = match_views(photographs, caster, seed)
        return maps[width]

    for without, part in {ALL: Part(), **PARTS}.items():
        with patch.multiple(masked_surface, match_views=once, **part.replaced):
            if without == ALL:
                find_surface(photos, hull, 0)  # makes stereo's maps
            began = time.process_time()
            surface = find_surface(photos, hull, 0, expert=part.options())
            seconds = time.process_time() - began
        scores = scores_of(surface.mesh, scene, truth)
        rows.append(
            PartRow(path.name, without, 1000 * scores["chamfer"], scores["normal_error"], seconds, program_commit())
        )
    return rows


if __name__ == "__main__":
    main()
