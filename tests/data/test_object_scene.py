"""A scene of one object, made of found masks, against the same capture loaded with these masks beside it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mgsr.config import make_config
from mgsr.data.object_scene import with_object
from mgsr.data.readers import load_scene
from tests.cli.spheres import write_spheres
from tests.optional import present


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Provide a capture whose images have alpha."""
    return write_spheres(tmp_path_factory.mktemp("capture") / "spheres")


def test_the_frame_is_that_of_the_capture_with_masks(folder: Path) -> None:
    masked = load_scene(folder, make_config().data)
    bare = load_scene(folder, make_config(overrides=["masks=off"]).data)
    assert not bare.masked and bare.user_from_scene.scale != pytest.approx(masked.user_from_scene.scale, rel=1e-3)
    train, test = ([present(view.alpha) for view in views] for views in (masked.train, masked.test))
    found = with_object(bare, train, test)
    assert found.masks_found and not masked.masks_found and not masked.mask_dissent
    assert found.user_from_scene.scale == pytest.approx(masked.user_from_scene.scale)
    np.testing.assert_allclose(found.user_from_scene.offset, masked.user_from_scene.offset, atol=1e-9)
    for one, other in zip(found.train + found.test, masked.train + masked.test, strict=True):
        np.testing.assert_allclose(one.camera.cam_from_world, other.camera.cam_from_world, atol=1e-9)
        np.testing.assert_array_equal(one.alpha, other.alpha)


def test_views_without_the_object_and_with_odd_masks_are_left_out(folder: Path) -> None:
    masked = load_scene(folder, make_config().data)
    bare = load_scene(folder, make_config(overrides=["masks=off"]).data)
    masks = [present(view.alpha) for view in masked.train]
    masks[0] = np.zeros_like(masks[0])
    masks[3] = np.roll(masks[3], 30, axis=1)
    found = with_object(bare, masks, [present(view.alpha) for view in masked.test])
    names = [view.name for view in found.train]
    assert bare.train[0].name not in names and bare.train[3].name not in names and len(names) == len(masks) - 2
    assert "exclude places that the others count as the object" in found.notes[-1]


def test_a_share_of_found_masks_may_dissent(folder: Path) -> None:
    masked = load_scene(folder, make_config().data)
    options = replace(make_config().expert.data, mask_dissent=0.25)
    bare = load_scene(folder, make_config(overrides=["masks=off"]).data, options=options)
    train, test = ([present(view.alpha) for view in views] for views in (masked.train, masked.test))
    assert with_object(bare, train, test).mask_dissent == len(train) // 4 > 0
