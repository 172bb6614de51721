"""Tests that packed scenes are small, and train as the scenes that were read."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from benchmarks.packed_scenes import Packed, pack, read, spread, unpack
from mgsr.config import Config, make_config
from mgsr.data.scene import Scene, View
from mgsr.shading.light_kind import LightKind
from mgsr.start.points import StartingPoints
from mgsr.training.run import Training
from tests.training.ball import ball_points, ball_scene

SETTINGS = ("warmup.surfel_iterations=10", "warmup.gaussian_iterations=10", "mutual.iterations=10", "reflection=both")
CONFIG = make_config("draft", overrides=SETTINGS)


def littered(view: View) -> View:
    """Return the view with arbitrary colours where its mask is zero."""
    litter = np.random.default_rng(0).integers(0, 256, view.image.shape, np.uint8)
    assert view.alpha is not None
    return replace(view, image=np.where(np.asarray(view.alpha > 0)[..., None], view.image, litter))


def packed(scene: Scene, folder: Path, start: StartingPoints | None = None) -> Packed:
    pack(Packed(scene, start or ball_points(400), {}), folder / "scene.npz")
    return unpack(folder / "scene.npz")


def learnt(scene: Scene, start: StartingPoints, config: Config = CONFIG) -> list[torch.Tensor]:
    model = Training(scene, start, config).run().model
    assert model.surfels is not None and model.gaussians is not None and model.environment_map is not None
    tensors = [
        *model.surfels.parameters().values(),
        *model.gaussians.parameters().values(),
        model.environment_map.maps(),
    ]
    return [tensor.detach() for tensor in tensors]


@pytest.mark.parametrize("masked", [True, False])
def test_trains_to_the_same_bytes(masked: bool, tmp_path: Path) -> None:
    scene = ball_scene(size=48, train=6, masked=masked)
    if masked:
        scene = replace(scene, train=[littered(view) for view in scene.train])
    content = packed(scene, tmp_path)
    expected, found = learnt(scene, ball_points(400)), learnt(content.scene, content.start)
    assert all(torch.equal(a, b) for a, b in zip(expected, found, strict=True))


def test_everything_comes_back(tmp_path: Path) -> None:
    random = np.random.default_rng(1)
    views = [
        replace(
            view,
            image=random.integers(0, 256, view.image.shape, np.uint8),
            alpha=None,
            irradiance=random.integers(0, 256, view.image.shape[:2], np.uint8),
            valid_mask=None if i else random.random(view.image.shape[:2]) < 0.5,
        )
        for i, view in enumerate(ball_scene(size=20, train=3).train)
    ]
    scene = replace(ball_scene(size=20), train=views, test=views[:1])
    points = replace(ball_points(50), light=LightKind.ENVIRONMENT)
    pack(Packed(scene, points, {"flash.npz": b"\0flash"}), tmp_path / "scene.npz")
    content = unpack(tmp_path / "scene.npz")
    assert [file.name for file in tmp_path.iterdir()] == ["scene.npz"]
    assert content.findings == {"flash.npz": b"\0flash"} and content.start.light is LightKind.ENVIRONMENT
    for name in ("positions", "normals", "colors"):
        np.testing.assert_array_equal(getattr(content.start, name), getattr(points, name))
    for found, expected in zip(content.scene.train + content.scene.test, views + views[:1], strict=True):
        assert found.name == expected.name and found.camera.width == expected.camera.width
        for name in ("image", "alpha", "irradiance", "valid_mask"):
            np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
        for name in ("K", "cam_from_world"):
            np.testing.assert_array_equal(getattr(found.camera, name), getattr(expected.camera, name))


def test_a_mask_makes_colours_behind_it_black(tmp_path: Path) -> None:
    """Check that colours behind a mask, which take part in nothing, are packed as black."""
    scene = ball_scene(size=48, train=4)
    full = packed(replace(scene, train=[littered(view) for view in scene.train]), tmp_path).scene
    for found, expected in zip(full.train, scene.train, strict=True):
        np.testing.assert_array_equal(found.alpha, expected.alpha)
        assert expected.alpha is not None
        np.testing.assert_array_equal(found.image, expected.image * (expected.alpha > 0)[..., None])


def test_where_not_every_view_has_a_mask_colours_stay(tmp_path: Path) -> None:
    """Check that colours stay where not every view has a mask: masks are ignored then, and all is trained on."""
    views = [littered(view) for view in ball_scene(size=48, train=4).train]
    views[0] = replace(views[0], alpha=None)
    for found, expected in zip(packed(replace(ball_scene(), train=views), tmp_path).scene.train, views, strict=True):
        np.testing.assert_array_equal(found.image, expected.image)
        np.testing.assert_array_equal(found.alpha, expected.alpha)


def test_views_at_even_distances() -> None:
    views = ball_scene(size=8, train=10).train
    assert [view.name for view in spread(views, 5)] == [view.name for view in views[::2]]
    assert spread(views, 10) == views == spread(views, 11)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "views"), [("spot_soft", 12), ("bunny_flash", None)])
def test_a_scene_trains_as_it_was_read(name: str, views: int | None, tmp_path: Path, shared_data: Path) -> None:
    """Check that a packed scene trains as the scene that was read; bunny_flash with its flash's light on each view."""
    content = read(shared_data / "scenes" / name, CONFIG, views)
    assert (
        (content.scene.train[0].irradiance is not None) is (name == "bunny_flash") is ("flash.npz" in content.findings)
    )
    pack(content, tmp_path / "scene.npz")
    other = unpack(tmp_path / "scene.npz")
    assert other.findings == content.findings
    expected, found = learnt(content.scene, content.start), learnt(other.scene, other.start)
    assert all(torch.equal(a, b) for a, b in zip(expected, found, strict=True))
