"""Photographs that were blurred by motion, among sharp ones, and captures of too few photographs."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import pytest

from mgsr.config import Flawed
from mgsr.config.expert import SharpnessOptions
from mgsr.data.camera import Camera
from mgsr.data.coverage import note_of_few_views
from mgsr.data.loading import LoadedView
from mgsr.data.scene import View
from mgsr.data.sharpness import less_sharp, without_blurred
from tests.data.captures import BallCapture

COUNT = 30


def texture(seed: int) -> np.ndarray:
    """Return smooth noise of many sizes, sharp to the pixel."""
    rng = np.random.default_rng(seed)
    image = np.zeros((96, 128, 3))
    for size in (4, 8, 16, 32, 128):
        image += cv2.resize(rng.normal(size=(size * 3 // 4, size, 3)), (128, 96), interpolation=cv2.INTER_CUBIC)
    return np.clip(128 + 30 * image, 0, 255).astype(np.uint8)


def moved(image: np.ndarray, length: int, angle: float) -> np.ndarray:
    """Return an image blurred as if the camera moved by `length` pixels."""
    steps = np.linspace(-0.5, 0.5, 4 * length)[:, None] * length * np.array([np.cos(angle), np.sin(angle)])
    shifts = [np.array([[1, 0, x], [0, 1, y]], np.float32) for x, y in steps]
    copies = [cv2.warpAffine(image, shift, (128, 96), borderMode=cv2.BORDER_REFLECT) for shift in shifts]
    mean: np.ndarray = np.mean(copies, axis=0).astype(np.uint8)
    return mean


def views(blurred: set[int], change: Callable[[np.ndarray, int], np.ndarray] = lambda image, i: image) -> list[View]:
    """Return views of a walk around an object; the photographs show other parts of one texture."""
    rng = np.random.default_rng(1)
    found = []
    for i, pose in enumerate(BallCapture(views=COUNT).poses()):
        image = texture(i // 5)
        image = moved(image, 9, rng.uniform(0, np.pi)) if i in blurred else image
        found.append(View(f"{i:03d}", Camera(np.eye(3), pose, 128, 96), change(image, i)))
    return found


@pytest.mark.parametrize("blurred", [set(), {4}, set(range(1, COUNT, 3)), {i for i in range(COUNT) if i % 3}])
def test_moved_photographs_are_told_from_sharp_ones(blurred: set[int]) -> None:
    assert set(np.flatnonzero(less_sharp(views(blurred)))) == blurred


def test_contrast_and_noise_are_no_blur() -> None:
    rng = np.random.default_rng(2)

    def change(image: np.ndarray, i: int) -> np.ndarray:
        dark = image * (0.3 if i % 2 else 1.0) + 10
        return np.clip(dark + rng.normal(0, 2, image.shape), 0, 255).astype(np.uint8)

    assert not less_sharp(views(set(), change)).any()


def test_a_plain_side_is_no_blur() -> None:
    """Check it where neighbours by name show opposite sides of the object, of which one has less detail."""
    found, detailed = [], texture(0)
    plain = cv2.GaussianBlur(detailed, (0, 0), 1.5)
    for i in range(COUNT):
        turn = np.radians(180 * (i % 2) + 360 * (i // 2) / COUNT)
        pose = np.eye(4)
        pose[:3, :3] = [[np.cos(turn), 0, -np.sin(turn)], [0, 1, 0], [np.sin(turn), 0, np.cos(turn)]]
        pose[2, 3] = 3
        image = cv2.addWeighted(detailed, 0.75 + 0.25 * np.cos(turn), plain, 0.25 - 0.25 * np.cos(turn), 0)
        found.append(View(f"{i:03d}", Camera(np.eye(3), pose, 128, 96), image))
    assert not less_sharp(found).any()
    assert less_sharp(found, SharpnessOptions(same_side=180)).any()


@pytest.mark.parametrize("blurred", list(Flawed))
def test_blurred_photographs_are_kept_or_dropped(blurred: Flawed) -> None:
    items = [LoadedView(view) for view in views({3, 8, 20})]
    (train, test), (note,) = without_blurred(items[:25], items[25:], blurred)
    assert note.startswith("3 of 30 photographs are much less sharp than their neighbours (003, 008, 020)")
    assert len(train) == (25 if blurred is Flawed.KEEP else 22) and len(test) == 5


def ring(count: int, arc: float = 360) -> list[View]:
    angles = np.radians(np.arange(count) * arc / count)
    found = []
    for angle in angles:
        pose = np.eye(4)
        pose[:3, 3] = -3 * np.array([np.cos(angle), np.sin(angle), 0.3])
        found.append(View("a", Camera(np.eye(3), pose, 8, 8), np.zeros((8, 8, 3), np.uint8)))
    return found


@pytest.mark.parametrize(
    ("photographs", "masked", "said"),
    [
        (ring(4), False, "the surface is a guess"),
        (ring(6), False, "the surface is a guess"),
        (ring(6, arc=60), False, "with 6 training photographs, the surface is rough"),
        (ring(4), True, "with 4 training photographs, the surface is hardly better than the visual hull"),
        (ring(16), False, None),
        (ring(12), True, None),
        (ring(9, arc=60), False, None),
    ],
)
def test_too_few_photographs(photographs: list[View], masked: bool, said: str | None) -> None:
    note = note_of_few_views(photographs, np.zeros(3), masked)
    if said is None:
        assert note is None
    else:
        assert note is not None and note.startswith("too few photographs") and said in note
