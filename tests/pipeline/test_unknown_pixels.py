"""What a photograph does not show: whatever stands at such pixels, every result is the same to the byte."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.ndimage import binary_dilation

from mgsr.config import Config, DataConfig, make_config
from mgsr.config.expert import NormalisationOptions
from mgsr.data.exposure import brightness_jumps
from mgsr.data.hull import carve
from mgsr.data.loading import reduced_view
from mgsr.data.normalise import normalisation
from mgsr.data.readers import load_scene
from mgsr.data.scene import Scene, View
from mgsr.data.silhouettes import view_silhouettes
from mgsr.export.scenes import write_scene
from mgsr.gaussians.trained_model import TrainedModel
from mgsr.pipeline.evaluation import image_scores
from mgsr.pipeline.meshing import make_mesh, make_textured
from mgsr.pipeline.rendering import render_views, scene_silhouettes
from mgsr.pipeline.report_pictures import draw_surface, report_pictures
from mgsr.pipeline.run_metadata import scene_facts
from mgsr.start.points import StartingPoints
from mgsr.start.starting_points import starting_points
from mgsr.training.run import Training
from tests.data.fisheye import write_fisheye
from tests.optional import present

SHORT = [
    "warmup.surfel_iterations=20",
    "warmup.gaussian_iterations=20",
    "mutual.iterations=12",
    "surfels.densify.every=8",
    "gaussians.densify.every=8",
    "surfels.densify.gradient_threshold=1e-5",
    "gaussians.densify.gradient_threshold=1e-5",
    "surfels.max_start=400",
    "gaussians.max_start=400",
    "coarse_side=16",
    "stop_rule=validation",
    "validation_every=10",
    "model_selection.iterations=4",
    "model_selection.views=2",
    "transmitted_tv_weight=0.1",
    "gaussian_depth_tv_weight=0.05",
    "curve_every=10",
    "mesh.view_scale=1",
    "mesh.poisson_depth=6",
    "mesh.min_alpha=0.05",
    "mesh.max_light_residual=1",
    "output.texture=64",
]


def with_garbage(scene: Scene, seed: int) -> Scene:
    """Return the scene with bright noise in images and masks wherever no photograph shows anything."""
    random = np.random.default_rng(seed)

    def noisy(view: View) -> View:
        assert view.valid_mask is not None
        noise = random.integers(0, 256, view.image.shape).astype(np.uint8)
        image = np.where(view.valid_mask[..., None], view.image, noise)
        alpha = (
            None if view.alpha is None else np.where(view.valid_mask, view.alpha, noise[..., 0] // 128 * np.uint8(255))
        )
        return replace(view, image=image, alpha=alpha)

    return replace(scene, train=[noisy(view) for view in scene.train], test=[noisy(view) for view in scene.test])


def everything(scene: Scene, folder: Path) -> Iterator[tuple[str, object]]:
    """Yield the results of a scene, stage by stage."""
    config = make_config("draft", overrides=SHORT)
    yield "frame", _frame(scene)
    yield "reduced views", [(view.image[view.valid_mask], view.valid_mask) for view in map(_halved, scene.train)]
    for each in scene_silhouettes(scene):
        yield "silhouette", (each.distance, each.valid_mask)
    yield "facts", repr(scene_facts(scene))
    start = starting_points(scene, 400, 0)
    yield "brightness", brightness_jumps(scene.train)
    yield "start", [start.positions, start.colors, start.normals, str(start.light)]
    models = _trained(scene, start, config)
    for model in (models.surfels, models.gaussians, models.environment_map):
        yield "training", [] if model is None else list(model.parameters().values())
    mesh = make_mesh(models, scene, config)
    yield "mesh", [mesh.vertices, mesh.faces, mesh.colors, str(mesh.light)]
    (textured,) = make_textured(models, scene, config, mesh)
    yield "texture", [textured.base_color, textured.normal_map, textured.occlusion, str(textured.material)]
    rendered = list(render_views(models, scene.test, config))
    behind = scene.backdrop(config.train.background).color
    scores = image_scores(rendered, scene, behind)
    yield "scores", repr(scores)
    drawn = draw_surface(mesh, None, scene)
    pictures = report_pictures(rendered, [0.0] * len(rendered), drawn, scene, models.environment_map, behind, {})
    yield "pictures", [view.photo for view in pictures.views]
    folder.mkdir()
    write_scene(folder, scene)
    yield "export", [(path.name, path.read_bytes()) for path in sorted(folder.rglob("*")) if path.is_file()]


def _frame(scene: Scene) -> object:
    frame = normalisation(scene.train, scene.points, view_silhouettes(scene.train, NormalisationOptions().contour_side))
    return [frame.scale, frame.offset]


def _halved(view: View) -> View:
    return reduced_view(view, 0.5)


def _trained(scene: Scene, start: StartingPoints, config: Config) -> TrainedModel:
    result = Training(scene, start, config).run()
    return result.model


def same(one: object, other: object) -> bool:
    if isinstance(one, list | tuple) and isinstance(other, list | tuple):
        return len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, torch.Tensor) and isinstance(other, torch.Tensor):
        return torch.equal(one, other)
    if isinstance(one, np.ndarray) and isinstance(other, np.ndarray):
        return np.array_equal(one, other)
    return bool(one == other)


@pytest.mark.slow
@pytest.mark.parametrize("masked", [True, False])
def test_what_stands_at_unknown_pixels_changes_nothing(masked: bool, tmp_path: Path) -> None:
    scene = load_scene(write_fisheye(tmp_path / "scene", masked=masked), DataConfig())
    shares = [view.valid_mask.mean() for view in scene.train if view.valid_mask is not None]
    assert len(shares) == len(scene.train) and max(shares) < 0.95
    first, second = (everything(with_garbage(scene, seed), tmp_path / str(seed)) for seed in (1, 2))
    for (stage, one), (_, other) in zip(first, second, strict=True):
        assert same(one, other), stage


def test_the_hull_is_whole_where_images_cut_the_object_off(tmp_path: Path) -> None:
    """Check that unknown pixels carve nothing off the ball, and that known pixels carve as much as they should.

    The masks say that nothing is at the unknown pixels.
    """
    scene = load_scene(write_fisheye(tmp_path / "scene"), DataConfig())
    assert scene.user_from_scene.scale == pytest.approx(0.8, rel=0.15)
    pairs = [(present(view.alpha), present(view.valid_mask)) for view in scene.train]
    cut = [((alpha > 127) & valid & binary_dilation(~valid)).sum() for alpha, valid in pairs]
    assert (np.array(cut) > 10).sum() >= 3
    bare = [
        replace(view, alpha=np.where(present(view.valid_mask), present(view.alpha), np.uint8(0)))
        for view in scene.train
    ]
    hull = carve(scene_silhouettes(replace(scene, train=bare)), np.zeros(3), 1.05, 64)
    directions = np.random.default_rng(0).normal(size=(2000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    frame = scene.user_from_scene

    def field(radius: float) -> np.ndarray:
        return hull.values(frame.to_scene(directions * radius))

    assert (field(0.8 * 0.97) > 0).all()
    assert np.median(field(0.8 * 1.1)) < 0
