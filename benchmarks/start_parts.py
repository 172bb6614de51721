"""The worth of each part of finding the starting surface.

    python -m benchmarks.start_parts RENDERED -o benchmarks/results/start_parts.csv [--scenes NAME ...]

For each scene of the tuning set, the surface that training begins on is found with all parts, and once without each of
them. Stereo's search is the same in all, and made once. Rows of other scenes stay in the file.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from benchmarks.evidence.surface_parts import ALL, PartRow
from benchmarks.scene_scores import find, replace_rows, scores_of
from benchmarks.scene_sets import SCENES, SceneSet
from mgsr.bench.machine import program_commit
from mgsr.config import make_config
from mgsr.data.hull import carve
from mgsr.data.readers import load_scene
from mgsr.data.silhouettes import silhouettes
from mgsr.geometry.mesh import Mesh
from mgsr.geometry.raycast import RayCaster
from mgsr.pipeline.evaluation import find_truth
from mgsr.shading.light_estimate import LightEstimate
from mgsr.start import masked_surface
from mgsr.start.masked_surface import find_surface
from mgsr.start.starting_points import MASK_SIDE, RESOLUTION
from mgsr.stereo import fusion
from mgsr.stereo.patch_match import DepthMap, match_views
from mgsr.stereo.photographs import StereoPhotographs

Part = Callable[[], Sequence[AbstractContextManager[Any]]]


def _replaced(**parts: Any) -> list[AbstractContextManager[Any]]:
    return [patch.object(masked_surface, name, part) for name, part in parts.items()]


def _unmoved(mesh: Mesh, *rest: Any, **more: Any) -> Mesh:
    return mesh


def _nothing(*rest: Any) -> Mesh:
    return Mesh(np.empty((0, 3)), np.empty((0, 3), np.int64))


PARTS: dict[str, Part] = {
    "stereo": lambda: _replaced(fuse_roughly=_nothing),
    "stereo on photographs of half the size": lambda: _replaced(
        weigh_gaps=lambda coarse, fine: [0 * each for each in coarse]
    ),
    "total variation": lambda: [patch.object(fusion, "VARIATION", 1e-6)],
    "the hull where it fits better": lambda: _replaced(CLEARLY=0.0, DISBELIEVED=np.inf),
    "shape from shading": lambda: _replaced(estimate_light=lambda *given: LightEstimate(), shape_from_shading=_unmoved),
    "photometric refinement": lambda: _replaced(refine_photometrically=_unmoved),
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
    outlines, truth, rows = silhouettes(scene.train, MASK_SIDE), find_truth(scene), []
    hull = carve(outlines, np.zeros(3), 1.05, RESOLUTION)

    maps: dict[int, list[DepthMap]] = {}

    def once(photographs: StereoPhotographs, caster: RayCaster, seed: int, **more: Any) -> list[DepthMap]:
        width = photographs.cameras[0].width
        if width not in maps:
            maps[width] = match_views(photographs, caster, seed)
        return maps[width]

    for without, part in {ALL: lambda: [], **PARTS}.items():
        with ExitStack() as stack:
            for change in (*_replaced(match_views=once), *part()):
                stack.enter_context(change)
            if without == ALL:
                find_surface(scene.train, outlines, hull, 0)  # makes stereo's maps
            began = time.process_time()
            surface = find_surface(scene.train, outlines, hull, 0)
            seconds = time.process_time() - began
        scores = scores_of(surface.mesh, scene, truth)
        rows.append(
            PartRow(path.name, without, 1000 * scores["chamfer"], scores["normal_error"], seconds, program_commit())
        )
    return rows


if __name__ == "__main__":
    main()
