"""Scores of a run: its test renders against the photographs, its mesh against the truth, where there is one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from mgsr.data.backdrop import WHITE, Color
from mgsr.data.images import read_image
from mgsr.data.scene import Scene, View
from mgsr.export.renders import straight_color
from mgsr.mesh.surface import ReconstructedMesh
from mgsr.metrics.image import image_metrics
from mgsr.metrics.split import SplitScore, mean_split, split_score
from mgsr.metrics.surface import normal_metrics, surface_metrics
from mgsr.metrics.truth import TrueSurface, load_truth
from mgsr.pipeline.rendering import RenderedView

# A scene's test views without any specular light, by the views' names.
MATTE_FOLDER = "test_matte"


def image_scores(rendered: Sequence[RenderedView], scene: Scene, background: Color = WHITE) -> dict[str, Any]:
    """Score the test renders against the photographs, over all pixels that the photographs show.

    psnr_test and ssim_test are on the background, None without test views. psnr_fg_test and psnr_fg_gain_test are
    present where there are masks. views: each view's values. split is present where the scene has matte test views.
    """
    views = {
        image.name: image_metrics(photograph(view), rendering(image), view.valid_mask, background)
        for image, view in zip(rendered, scene.test, strict=True)
    }
    scores: dict[str, Any] = {"psnr_test": _mean(views, "psnr"), "ssim_test": _mean(views, "ssim")}
    for name in ("psnr_fg", "psnr_fg_gain"):
        if (value := _mean(views, name)) is not None:
            scores[f"{name}_test"] = value
    split = _split(rendered, scene)
    return scores | {"views": views} | ({} if split is None else {"split": split})


def find_truth(scene: Scene) -> TrueSurface | None:
    """Load the true surface, in the user's frame, where a `mesh_gt.ply` lies in the scene's folder."""
    to_user = scene.user_from_scene.camera_to_user
    return load_truth(scene.root, [to_user(view.camera) for view in scene.train])


def surface_scores(mesh: ReconstructedMesh, truth: TrueSurface | None, scene: Scene) -> dict[str, Any]:
    """Score a mesh of the user's frame against the truth, as {"gt": scores}; None in their place without a truth."""
    if truth is None:
        return {"gt": None}
    scores = surface_metrics(mesh, truth)
    if scene.test:
        cameras = [scene.user_from_scene.camera_to_user(view.camera) for view in scene.test]
        scores |= normal_metrics(mesh, truth, cameras)
    return {"gt": scores}


def photograph(view: View) -> np.ndarray:
    """Return a view's photograph, uint8 [H,W,3], or [H,W,4] with straight alpha where the view has a mask."""
    return view.image if view.alpha is None else np.dstack([view.image, view.alpha])


def rendering(image: RenderedView) -> np.ndarray:
    """Return an image as float32 [H,W,4] with straight alpha."""
    return np.dstack([straight_color(image.color, image.alpha), np.clip(image.alpha, 0, 1)])


def _split(rendered: Sequence[RenderedView], scene: Scene) -> dict[str, float] | None:
    scores = []
    for image, view in zip(rendered, scene.test, strict=True):
        score = _split_view(image, view, scene)
        if score is not None:
            scores.append(score)
    if not scores:
        return None
    mean = mean_split(scores)
    return {"split_psnr": mean.split_psnr, "split_photo": mean.split_photo, "split_gain": mean.split_gain}


def _split_view(image: RenderedView, view: View, scene: Scene) -> SplitScore | None:
    """Score the light split of a view.

    Returns None without a light split or without a matte picture of the view's size. It also returns None where the
    photograph has invalid pixels, since the matte picture is not undistorted.
    """
    path = scene.root / MATTE_FOLDER / f"{view.name}.png"
    if image.transmitted is None or view.valid_mask is not None or not path.is_file():
        return None
    color, alpha = read_image(path, path.name)
    if alpha is None or color.shape != view.image.shape:
        return None
    photo = photograph(view) if view.alpha is not None else off_white(view.image, alpha)
    return split_score(np.dstack([color, alpha]), straight_color(image.transmitted, image.alpha), photo)


def off_white(image: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Remove a white background from an image [H,W,3] with alpha [H,W], both uint8: straight colours, float 0..1.

    It serves photographs without their masks, so that their silhouettes are scored as with masks.
    """
    cover = alpha[..., None] / 255.0
    return np.clip((image / 255.0 - (1 - cover)) / np.maximum(cover, 1 / 255), 0, 1)


def _mean(views: dict[str, dict[str, float]], name: str) -> float | None:
    values = [scores[name] for scores in views.values() if name in scores]
    return float(np.mean(values)) if values else None
