"""Outlines that are learned: objects before plain backdrops, whose true masks are known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from mgsr.config import ExpertConfig, make_config
from mgsr.data.scene import Scene, View
from mgsr.errors import Cancelled
from mgsr.native import runtime
from mgsr.training.learned_masks import learn_masks
from tests.optional import present
from tests.training.ball import ball_scene, before, surface_points


def overlaps(masks: Sequence[np.ndarray], truth: Scene) -> np.ndarray:
    """Return for each view the share of the pixels in the mask or in the true one that are in both."""
    pairs = [(mask > 127, present(view.alpha) > 127) for mask, view in zip(masks, truth.train, strict=True)]
    return np.array([(mask & true).sum() / (mask | true).sum() for mask, true in pairs])


def short(iterations: int = 300) -> ExpertConfig:
    """Return options of a short training, as a ball needs no longer one."""
    return make_config(overrides=[f"learned_masks.iterations={iterations}"]).expert


@pytest.fixture(scope="module")
def truth() -> Scene:
    return ball_scene(size=64, train=24, gloss=0.8)


@pytest.mark.parametrize("color", [(255, 255, 255), pytest.param((90, 120, 60), marks=pytest.mark.slow)])
def test_what_splats_come_to_cover_is_the_object(truth: Scene, color: tuple[int, int, int]) -> None:
    """Check that what splats come to cover is the object.

    The ball's paint has both light and dark patches, and a highlight that clips.
    """
    reported: list[float] = []
    masks = learn_masks(before(color, noise=0, scene=truth), seed=0, progress=reported.append, expert=short())
    assert masks is not None and all(mask.shape == (64, 64) and mask.dtype == np.uint8 for mask in masks)
    assert overlaps(masks, truth).min() > 0.96 and overlaps(masks, truth).mean() > 0.975
    assert (
        reported == sorted(reported) and reported[-1] == pytest.approx(1) and any(0 < done < 0.5 for done in reported)
    )


@pytest.mark.slow
def test_paint_of_the_backdrops_colour_makes_no_hole(truth: Scene) -> None:
    """Check that a white disk painted around the ball's pole makes no hole.

    A mask by colour has a hole there, seen from above.
    """

    def painted(view: View) -> View:
        disk = surface_points(view.camera)[0][..., 2] > 0.45
        image = np.where((disk & (present(view.alpha) > 127))[..., None], 255, view.image).astype(np.uint8)
        return replace(view, image=image)

    white = before((255, 255, 255), noise=0, scene=replace(truth, train=[painted(view) for view in truth.train]))
    by_colour = [255 * np.any(view.image < 250, axis=-1).astype(np.uint8) for view in white.train]
    masks = learn_masks(white, seed=0, expert=short())
    assert masks is not None
    assert overlaps(by_colour, truth).min() < 0.9 and overlaps(masks, truth).min() > 0.95


@pytest.mark.slow
def test_the_same_seed_gives_the_same_masks(truth: Scene) -> None:
    scene, found = before((0, 0, 0), noise=0, scene=truth), []
    try:
        for threads in (1, 2):
            runtime.set_threads(threads)
            found.append(learn_masks(scene, seed=1, expert=short(60)))
    finally:
        runtime.set_threads(0)
    assert found[0] is not None and found[1] is not None
    np.testing.assert_array_equal(np.stack(found[0]), np.stack(found[1]))


def test_none_where_photographs_contradict_each_other(truth: Scene) -> None:
    """Check that no masks come out where every other photograph shows the backdrop alone.

    Splats fill all of space with its colour.
    """
    scene = before((255, 255, 255), noise=0, scene=truth)
    gone = [replace(view, image=np.full_like(view.image, 255)) for view in scene.train[::2]]
    assert learn_masks(replace(scene, train=gone + scene.train[1::2]), seed=0, expert=short()) is None


def test_a_wish_to_stop_is_heeded(truth: Scene) -> None:
    with pytest.raises(Cancelled, match="stopped on request in learned_masks after 0 iterations"):
        learn_masks(before((0, 0, 0), noise=0, scene=truth), seed=0, should_stop=lambda: True)
