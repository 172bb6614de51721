"""Masks that are silhouettes, and masks that say what to ignore, drawn where their kind has them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from mgsr.config import DataConfig, Masks
from mgsr.data.camera import Camera
from mgsr.data.mask_use import MaskUse, find_mask_use
from mgsr.data.readers import load_scene
from mgsr.errors import SceneError
from mgsr.export.scenes import write_scene
from tests.data.captures import SIDE, BallCapture, save

BALL = BallCapture(views=24)
# The same cameras with a lens so long that the ball fills most of the image, and is cut off at its sides.
CLOSE = BallCapture(views=24, K=np.array([[125.0, 0, 30], [0, 125, 35], [0, 0, 1]]))


def cameras(ball: BallCapture) -> list[Camera]:
    return [Camera(ball.K, pose, SIDE, SIDE) for pose in ball.poses()]


def silhouettes(ball: BallCapture) -> list[np.ndarray]:
    return [ball.rgba(pose)[..., 3] for pose in ball.poses()]


def passers_by(share: float, empty: float = 0.4) -> list[np.ndarray]:
    """Return masks with black rectangles of a share of the image at random places, in most views."""
    rng = np.random.default_rng(5)
    masks = []
    for _ in range(BALL.views):
        mask = np.full((SIDE, SIDE), 255, np.uint8)
        side = int(SIDE * share**0.5)
        if rng.random() > empty:
            row, column = rng.integers(0, SIDE - side // 2, 2)
            mask[row : row + side, column : column + side] = 0
        masks.append(mask)
    return masks


def strip() -> list[np.ndarray]:
    """Return masks that are black at the bottom, as of the camera's own stand."""
    mask = np.full((SIDE, SIDE), 255, np.uint8)
    mask[-12:] = 0
    return [mask] * BALL.views


def standing_still() -> list[np.ndarray]:
    """Return masks that hide a thing at one place in space, beside what the cameras look at."""
    masks = []
    for camera in cameras(BALL):
        pixels, depth = camera.project(np.array([[0.7, 0.2, -0.4]]))
        y, x = np.mgrid[:SIDE, :SIDE] + 0.5
        hidden = np.hypot(x - pixels[0, 0], y - pixels[0, 1]) < 0.4 * camera.K[0, 0] / depth[0]
        masks.append(np.where(hidden, 0, 255).astype(np.uint8))
    return masks


@pytest.mark.parametrize("ball", [BALL, CLOSE], ids=["whole", "cut off"])
def test_silhouettes(ball: BallCapture) -> None:
    assert find_mask_use(silhouettes(ball), cameras(ball)) is MaskUse.OBJECT


@pytest.mark.parametrize("masks", [passers_by(0.05), passers_by(0.2), passers_by(0.4, empty=0), strip()])
def test_what_is_to_be_ignored(masks: list[np.ndarray]) -> None:
    assert find_mask_use(masks, cameras(BALL)) is MaskUse.IGNORE


def test_a_thing_that_stands_still_may_be_either() -> None:
    with pytest.raises(SceneError, match=r"may mark an object or areas to ignore .*masks=object .*masks=ignore"):
        find_mask_use(standing_still(), cameras(BALL))


def test_a_ball_that_all_images_cut_off_may_be_either() -> None:
    """Check that such masks are doubtful: the ball leaves the corners black, and so does a round lens hood."""
    close = BallCapture(views=24, K=np.array([[145.0, 0, 32], [0, 145, 32], [0, 0, 1]]))
    with pytest.raises(SceneError, match="may mark an object or areas to ignore"):
        find_mask_use(silhouettes(close), cameras(close))


def test_inverted_silhouettes() -> None:
    with pytest.raises(SceneError, match=r"the masks are inverted, .*masks=ignore"):
        find_mask_use([255 - mask for mask in silhouettes(BALL)], cameras(BALL))


def capture(root: Path, masks: Sequence[np.ndarray | None], names: str = "masks/{:03d}.png") -> Path:
    BALL.write_plain(root, mode="RGB")
    for i, mask in enumerate(masks):
        if mask is not None:
            save(root / names.format(i), mask, "L")
    return root


@pytest.mark.parametrize("names", ["masks/{:03d}.png", "masks/{:03d}.png.png"], ids=["plain", "as COLMAP"])
def test_ignored_pixels_are_unknown(tmp_path: Path, names: str) -> None:
    masks = passers_by(0.1)
    scene = load_scene(capture(tmp_path, masks, names), DataConfig())
    assert not scene.masked
    for view in scene.train + scene.test:
        black = masks[int(view.name)] < 128
        if not black.any():
            assert view.valid_mask is None
            continue
        # The pixels beside the black ones hold something of them.
        wide = np.pad(black, 1)
        around = sum(wide[1 + i : 1 + i + SIDE, 1 + j : 1 + j + SIDE] for i in (-1, 0, 1) for j in (-1, 0, 1)) > 0
        np.testing.assert_array_equal(view.valid_mask, ~around)


def test_photographs_without_a_mask_are_used_whole(tmp_path: Path) -> None:
    masks = [mask if i % 3 else None for i, mask in enumerate(passers_by(0.1))]
    scene = load_scene(capture(tmp_path, masks), DataConfig())
    assert len(scene.train) + len(scene.test) == 24 and not scene.masked
    assert scene.notes[0].startswith("the masks mark areas to ignore")


def test_instant_ngps_dynamic_masks(tmp_path: Path) -> None:
    """Check that white is ignored in dynamic_mask_NAME.png beside the photograph, as colmap2nerf.py writes them."""
    masks = [255 - mask for mask in passers_by(0.1)]
    scene = load_scene(capture(tmp_path, masks, "photos/dynamic_mask_{:03d}.png"), DataConfig())
    assert len(scene.train) + len(scene.test) == 24
    for view in scene.train:
        white = masks[int(view.name)] > 128
        assert (view.valid_mask is None) == (not white.any())
        assert view.valid_mask is None or not view.valid_mask[white].any()


@pytest.mark.parametrize("top", [0.15, 0.3])
def test_skies_are_no_silhouettes(tmp_path: Path, top: float) -> None:
    """Check masks that are black above, where sky lies behind every object.

    Either they are ignored, or the two meanings are named.
    """
    masks = [np.full((SIDE, SIDE), 255, np.uint8) for _ in range(BALL.views)]
    for i, mask in enumerate(masks):
        mask[: int(SIDE * top) + i % 5] = 0
    root = capture(tmp_path, masks)
    if top < 0.2:  # nearly a strip
        assert not load_scene(root, DataConfig()).masked
    else:
        with pytest.raises(SceneError, match="may mark an object or areas to ignore"):
            load_scene(root, DataConfig())


@pytest.mark.slow
def test_a_lens_hood_is_no_silhouette(tmp_path: Path) -> None:
    y, x = np.mgrid[:SIDE, :SIDE] + 0.5
    hood = np.where(np.hypot(x - 32, y - 32) < 34, 255, 0).astype(np.uint8)
    with pytest.raises(SceneError, match="may mark an object or areas to ignore"):
        load_scene(capture(tmp_path, [hood] * BALL.views), DataConfig())


def test_what_is_ignored_does_not_shrink_the_ball(tmp_path: Path) -> None:
    masks = [mask.copy() for mask in strip()]
    root = capture(tmp_path, masks)
    scale = load_scene(root, DataConfig()).user_from_scene.scale
    assert scale == load_scene(root, DataConfig(masks=Masks.OFF)).user_from_scene.scale


def test_a_scene_for_other_programs_keeps_what_is_ignored(tmp_path: Path) -> None:
    scene = load_scene(capture(tmp_path / "scene", passers_by(0.1)), DataConfig())
    write_scene(tmp_path, scene)
    again = load_scene(tmp_path, DataConfig())
    assert not again.masked and len(again.train) == len(scene.train)
    for view, other in zip(again.train, scene.train, strict=True):
        assert view.image.shape == other.image.shape
        assert (view.valid_mask is None) == (other.valid_mask is None)


def test_the_meaning_that_is_given_counts(tmp_path: Path) -> None:
    root = capture(tmp_path, standing_still())
    assert load_scene(root, DataConfig(masks=Masks.OBJECT)).masked
    assert not load_scene(root, DataConfig(masks=Masks.IGNORE)).masked
    off = load_scene(root, DataConfig(masks=Masks.OFF))
    assert not off.masked and all(view.valid_mask is None for view in off.train)


def test_ignore_without_masks_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="masks=ignore: no photograph has a mask; copy masks to masks/"):
        load_scene(capture(tmp_path, []), DataConfig(masks=Masks.IGNORE))
