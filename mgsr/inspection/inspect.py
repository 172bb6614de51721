"""The inspection of a capture before training: it finds problems, the affected photographs, and remedies."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np

from mgsr.config.expert import InspectionConfig
from mgsr.data.scene import Scene, View, some_of
from mgsr.inspection.coverage import check_parallax, check_sides
from mgsr.inspection.exposure_check import check_exposures
from mgsr.inspection.features import Features, find_features
from mgsr.inspection.findings import Code, Finding, InspectedPhoto, Inspection, Severity, sorted_by_severity
from mgsr.inspection.pairs import Likeness, Pair, compare_pairs
from mgsr.inspection.photo_check import (
    check_lenses,
    check_masks,
    check_object_size,
    check_sharpness,
)
from mgsr.inspection.pose_check import check_movement, check_poses, group_by_pose
from mgsr.inspection.tracks import Tracks, find_tracks
from mgsr.inspection.verdicts import Judged, Verdict, judge, pairs_by_photo


def inspect_scene(
    scene: Scene,
    progress: Callable[[float], None] = lambda done: None,
    options: InspectionConfig = InspectionConfig(),
) -> Inspection:
    """Inspect the photographs, cameras and masks of a scene, which stays unchanged.

    progress: receives the share that is done, 0..1; it may raise. options: the limits of all checks.
    """
    started_at = time.perf_counter()
    views = [*scene.train, *scene.test]
    names = photo_names(scene)
    # Views and names are sampled by the same indices.
    chosen = some_of(range(len(views)), options.photographs)
    compared = [views[index] for index in chosen]
    features = find_features(compared, options.features)
    progress(0.4)
    judged = _judged_pairs(compared, features, lambda done: progress(0.4 + 0.5 * done), options)
    agreeing = judged.of(Verdict.AGREES)
    tracks = find_tracks([view.camera for view in compared], features, agreeing, options.track)
    compared_names = [names[index] for index in chosen]
    found = check_poses(compared_names, [len(one) for one in features], judged, options)
    found += check_movement(judged.pairs, options)
    found += check_exposures(compared, compared_names, features, judged.pairs, options, scene.options.brightness)
    found += check_photographs(scene, views, names, tracks, options)
    photographs = _photographs(scene, compared, compared_names, judged.pairs, tracks)
    return Inspection(sorted_by_severity(found), photographs, time.perf_counter() - started_at)


def _judged_pairs(
    views: Sequence[View],
    features: Sequence[Features],
    progress: Callable[[float], None],
    options: InspectionConfig,
) -> Judged:
    """Judge the pairs of similar photographs, and then pairs between each other group and the largest group."""
    likeness = Likeness.of(views, features, options.features)
    count = len(views)
    like = likeness.pairs(~np.eye(count, dtype=bool), options.pairs)
    pairs = compare_pairs(views, features, like, lambda done: progress(0.7 * done), options)
    cameras = [view.camera for view in views]
    group = group_by_pose(count, judge(cameras, features, pairs, options), options.poses).group
    rich = np.array([len(one) for one in features]) >= options.pairs.min_matches
    across = (group[:, None] > 0) & (group[None] == 0) & rich[:, None] & rich[None]
    known = {(pair.one, pair.other) for pair in pairs}
    more = [pair for pair in likeness.pairs(across, options.pairs) if pair not in known]
    pairs += compare_pairs(views, features, more, lambda done: progress(0.7 + 0.3 * done), options)
    return judge(cameras, features, pairs, options)


def check_photographs(
    scene: Scene, views: Sequence[View], names: Sequence[str], tracks: Tracks, options: InspectionConfig
) -> list[Finding]:
    """Return the findings that need no pairs of photographs. tracks: points that photographs share."""
    found = check_sharpness(views, names, scene.options.sharpness)
    found += check_sides([view.camera for view in views], names, scene.user_from_scene, options.coverage)
    target = np.median(tracks.points, axis=0) if len(tracks.points) >= options.min_points else np.zeros(3)
    found += check_parallax(np.array([view.camera.center for view in views]), target, options.coverage)
    found += check_object_size(scene, views, options.photos)
    if scene.masked:
        found += check_masks(scene, names[: len(scene.train)], options.photos)
    found += check_lenses(views, names, options.photos)
    if scene.warning is not None:
        what, _, cure = scene.warning.partition("; ")
        found.append(Finding(Code.FEW_PHOTOGRAPHS, Severity.WARNING, what, len(scene.train), "photographs", cure))
    return found


def photo_names(scene: Scene) -> list[str]:
    """Return the names of all photographs; a test photograph is `test/NAME` if a training photograph has its NAME."""
    trained = {view.name for view in scene.train}
    test = [f"test/{view.name}" if view.name in trained else view.name for view in scene.test]
    return [*(view.name for view in scene.train), *test]


def _photographs(
    scene: Scene, views: Sequence[View], names: Sequence[str], pairs: Sequence[Pair], tracks: Tracks
) -> tuple[InspectedPhoto, ...]:
    reprojection = tracks.reprojection([view.camera for view in views])
    residuals = _residuals(len(views), pairs)
    found = []
    for index, (view, name) in enumerate(zip(views, names, strict=True)):
        camera = scene.user_from_scene.camera_to_user(view.camera)
        axes = camera.cam_from_world[:3, :3]
        sides = np.array([camera.width, camera.height]) / camera.K[[0, 1], [0, 1]]
        across, down = np.degrees(2 * np.arctan(sides / 2)).round(2).tolist()
        found.append(
            InspectedPhoto(
                name,
                _place(camera.center),
                _place(axes[2]),
                _place(-axes[1]),
                (across, down),
                _rounded(residuals[index]),
                _rounded(reprojection[index]),
            )
        )
    return tuple(found)


def _residuals(count: int, pairs: Sequence[Pair]) -> np.ndarray:
    """Return each photograph's median residual [V], pixels, over the pairs whose matches share a geometry.

    The result is NaN for a photograph without such a pair.
    """
    mine = [[pair.residual * pair.scale for pair in each] for each in pairs_by_photo(pairs, count, 1)]
    return np.array([np.median(each) if each else np.nan for each in mine])


def _place(values: np.ndarray) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return x, y, z


def _rounded(value: float) -> float | None:
    return round(float(value), 2) if np.isfinite(value) else None
