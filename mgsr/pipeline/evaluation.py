"""Scores of a run: of its test renders against the photographs, and of its mesh against the true surface."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from mgsr.data.backdrop import WHITE, Color
from mgsr.data.exposure import raised_where_clipped
from mgsr.data.images import read_image
from mgsr.data.scene import Scene, View
from mgsr.export.renders import straight_color
from mgsr.mesh.surface import ReconstructedMesh
from mgsr.metrics.image import image_metrics, psnr
from mgsr.metrics.split import SplitScore, mean_split, split_score
from mgsr.metrics.surface import normal_metrics, surface_metrics
from mgsr.metrics.truth import TrueSurface, load_truth
from mgsr.pipeline.rendering import RenderedView
from mgsr.report.data import SplitFacts

# A scene's test views without any specular light, by the views' names.
MATTE_FOLDER = "test_matte"


@dataclass(frozen=True)
class ImageScores:
    """The scores of the test renders against the photographs, over all pixels that the photographs show.

    psnr_test, ssim_test: of all pixels, before a plain background; None without test views.
    psnr_fg_test, psnr_fg_gain_test: of the object's pixels; None without masks.
    psnr_whole_test: of renders before a found object's trained background, against the whole photographs; None without
    such a background.
    views: each view's scores.
    split: the scores of the light split; None without matte test views.
    """

    psnr_test: float | None
    ssim_test: float | None
    psnr_fg_test: float | None
    psnr_fg_gain_test: float | None
    psnr_whole_test: float | None
    views: dict[str, dict[str, float]]
    split: SplitFacts | None

    @property
    def optional(self) -> dict[str, Any]:
        """Return the existing scores other than psnr_test and ssim_test, by name."""
        names = ("psnr_fg_test", "psnr_fg_gain_test", "psnr_whole_test", "views", "split")
        return {name: value for name in names if (value := getattr(self, name)) is not None}

    def to_json(self) -> dict[str, Any]:
        """Return the existing scores by name, as plain types; psnr_test and ssim_test are always included."""
        split = {} if self.split is None else {"split": asdict(self.split)}
        return {"psnr_test": self.psnr_test, "ssim_test": self.ssim_test} | self.optional | split


def image_scores(rendered: Sequence[RenderedView], scene: Scene, background: Color = WHITE) -> ImageScores:
    """Score the test renders against the photographs. background: the colour behind views without masks."""
    views = {
        image.name: _compared(image, view, background) | _whole(image, view)
        for image, view in zip(rendered, scene.test, strict=True)
    }
    return ImageScores(
        psnr_test=_mean(views, "psnr"),
        ssim_test=_mean(views, "ssim"),
        psnr_fg_test=_mean(views, "psnr_fg"),
        psnr_fg_gain_test=_mean(views, "psnr_fg_gain"),
        psnr_whole_test=_mean(views, "psnr_whole"),
        views=views,
        split=_split(rendered, scene),
    )


def find_truth(scene: Scene) -> TrueSurface | None:
    """Load the true surface from `mesh_gt.ply` in the scene's folder, in the user's frame; None without that file."""
    to_user = scene.user_from_scene.camera_to_user
    return load_truth(scene.root, [to_user(view.camera) for view in scene.train])


def surface_scores(mesh: ReconstructedMesh, truth: TrueSurface | None, scene: Scene) -> dict[str, float] | None:
    """Return the scores, by name, of a mesh of the user's frame against the truth; None without a truth."""
    if truth is None:
        return None
    scores = surface_metrics(mesh, truth)
    if scene.test:
        cameras = [scene.user_from_scene.camera_to_user(view.camera) for view in scene.test]
        scores |= normal_metrics(mesh, truth, cameras)
    return scores


def photograph(view: View) -> np.ndarray:
    """Return a view's photograph, uint8 [H,W,3], or [H,W,4] with straight alpha where the view has a mask."""
    return view.image if view.alpha is None else np.dstack([view.image, view.alpha])


def rendering(image: RenderedView) -> np.ndarray:
    """Return an image as float32 [H,W,4] with straight alpha."""
    return np.dstack([straight_color(image.color, image.alpha), np.clip(image.alpha, 0, 1)])


def _compared(image: RenderedView, view: View, background: Color) -> dict[str, float]:
    """Return the metrics of a render against the photograph, by name."""
    shown = rendering(image)
    photo = raised_where_clipped(view, np.clip(shown[..., :3], 0, 1))
    truth = photo if view.alpha is None else np.dstack([photo, view.alpha / 255])
    return image_metrics(truth, shown, view.valid_mask, background)


def _whole(image: RenderedView, view: View) -> dict[str, float]:
    """Score a render with its background against the whole photograph; empty without a background."""
    if image.whole is None:
        return {}
    whole = np.clip(image.whole, 0, 1)
    return {"psnr_whole": psnr(raised_where_clipped(view, whole), whole, view.valid_mask)}


def _split(rendered: Sequence[RenderedView], scene: Scene) -> SplitFacts | None:
    scores = []
    for image, view in zip(rendered, scene.test, strict=True):
        score = _split_view(image, view, scene)
        if score is not None:
            scores.append(score)
    if not scores:
        return None
    mean = mean_split(scores)
    return SplitFacts(mean.split_psnr, mean.split_photo, mean.split_gain)


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
    """Remove a white background from an image [H,W,3] with alpha [H,W], both uint8; return straight colours 0..1.

    It lets photographs without masks be scored like photographs with masks.
    """
    cover = alpha[..., None] / 255.0
    return np.clip((image / 255.0 - (1 - cover)) / np.maximum(cover, 1 / 255), 0, 1)


def _mean(views: dict[str, dict[str, float]], name: str) -> float | None:
    values = [scores[name] for scores in views.values() if name in scores]
    return float(np.mean(values)) if values else None
