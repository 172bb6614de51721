"""All metrics of one result at once, from what lies in files: a mesh or a folder of renders against a scene.

Both functions return plain dicts whose names and units are those of the modules that compute them: surface.py and
normals.py for the mesh, image.py and split.py for the renders.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mgsr.data.camera import Camera
from mgsr.data.images import read_image
from mgsr.data.scene import Scene, View
from mgsr.errors import SceneError
from mgsr.metrics.image import image_metrics
from mgsr.metrics.normals import normal_metrics
from mgsr.metrics.split import SplitScore, mean_split, split_score
from mgsr.metrics.surface import MIN_VIEWS, surface_metrics
from mgsr.metrics.truth import load_truth

MATTE_FOLDER = "test_matte"  # a scene's test views without specular light, by the views' names


def evaluate_mesh(
    scene_root: Path,
    vertices: np.ndarray,
    faces: np.ndarray,
    test_cameras: Sequence[Camera],
    train_cameras: Sequence[Camera] = (),
) -> dict[str, float]:
    """A mesh, vertices [V,3] and faces [F,3] in the user's frame, against the scene's ``mesh_gt.ply``.

    The names of `surface_metrics` (chamfer, accuracy, completeness, f_005, f_010, f_020, normal_consistency,
    normal_consistency_signed) and, with test_cameras, of `normal_metrics` (normal_error, normal_error_median,
    mask_iou, depth_error). Distances are in the true mesh's bounding radius, angles in degrees. train_cameras say
    what was seen of the truth where no ``points_gt.npz`` does. All cameras are in the user's frame.

    Raises SceneError without a truth, or where nothing says what was seen of it; MeshError for a mesh without faces.
    """
    if not (scene_root / "points_gt.npz").is_file() and len(train_cameras) < MIN_VIEWS:
        raise SceneError(
            f"{scene_root}: expected points_gt.npz or at least {MIN_VIEWS} train_cameras, to know which parts of the "
            f"truth were seen; got {len(train_cameras)} cameras"
        )
    truth = load_truth(scene_root, train_cameras)
    if truth is None:
        raise SceneError(f"{scene_root}: expected the true surface in mesh_gt.ply; there is none to compare with")
    scores = surface_metrics(vertices, faces, truth)
    return scores | (normal_metrics(vertices, faces, truth, test_cameras) if test_cameras else {})


def evaluate_renders(scene: Scene, renders: Path) -> dict[str, Any]:
    """A folder's ``<view>.png`` (RGBA with straight alpha, or RGB on white) against the scene's test views.

    Means over the views: psnr, ssim and, with masks, psnr_fg and psnr_fg_gain (`image_metrics`); views: the same for
    each view; split_psnr, split_photo and split_gain (`SplitScore`) where the scene has matte test views and the
    folder has ``<view>_transmitted.png``. dB.

    Raises SceneError for a scene without test views, a render that is missing and one of another size.
    """
    if not scene.test:
        raise SceneError(f"{scene.root}: expected test views to compare the renders with; the scene has none")
    views = {view.name: image_metrics(_photograph(view), _render(renders, view, "")) for view in scene.test}
    names = dict.fromkeys(name for scores in views.values() for name in scores)
    means = {name: float(np.mean([scores[name] for scores in views.values() if name in scores])) for name in names}
    splits = [score for view in scene.test if (score := _split(scene.root, renders, view)) is not None]
    return {**means, **(_split_names(mean_split(splits)) if splits else {}), "views": views}


def _split(root: Path, renders: Path, view: View) -> SplitScore | None:
    matte = root / MATTE_FOLDER / f"{view.name}.png"
    if not matte.is_file() or not (renders / f"{view.name}_transmitted.png").is_file():
        return None
    return split_score(_read(matte, view), _render(renders, view, "_transmitted"), _photograph(view))


def _split_names(score: SplitScore) -> dict[str, float]:
    return {"split_psnr": score.split_psnr, "split_photo": score.split_photo, "split_gain": score.split_gain}


def _render(folder: Path, view: View, suffix: str) -> np.ndarray:
    return _read(folder / f"{view.name}{suffix}.png", view)


def _read(path: Path, view: View) -> np.ndarray:
    """uint8 [H,W,3 or 4] of the view's size."""
    color, alpha = read_image(path, f"the comparison with view {view.name}")
    if color.shape != view.image.shape:
        raise SceneError(f"{path}: expected the view's size {view.image.shape[:2]}, got {color.shape[:2]}")
    return color if alpha is None else np.dstack([color, alpha])


def _photograph(view: View) -> np.ndarray:
    return view.image if view.alpha is None else np.dstack([view.image, view.alpha])
