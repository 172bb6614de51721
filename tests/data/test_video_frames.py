"""Frames that are chosen from pans, rests and cuts whose motion is known."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from mgsr.data.video_frames import choose_frames, write_frames
from mgsr.errors import SceneError
from tests.data.films import HEIGHT, WIDTH, film, pan

DIAGONAL = float(np.hypot(WIDTH, HEIGHT))


def chosen(tmp_path: Path, frames: list[np.ndarray], most: int = 200) -> list[int]:
    """Return the numbers of the frames that are chosen from a video of these."""
    files, line = write_frames(film(tmp_path / "walk.mp4", frames), tmp_path / "images", most, 1600, lambda done: None)
    assert line == f"{len(files)} of {len(frames)} frames of walk.mp4 are used, by motion and sharpness"
    assert all(Image.open(file).size == (WIDTH, HEIGHT) for file in files)
    return [int(file.stem.removeprefix("frame_")) for file in files]


def test_a_slow_pan_gives_as_many_frames_as_it_moves(tmp_path: Path) -> None:
    lefts = np.linspace(0, 800, 120)
    numbers = chosen(tmp_path, pan(lefts))
    # 800 pixels are two diagonals, and a step is 0.04 of one.
    assert len(numbers) == pytest.approx(800 / DIAGONAL / 0.04, abs=4)
    steps = np.diff(lefts[numbers]) / DIAGONAL
    assert steps.min() > 0.01 and steps.max() < 0.09


def test_a_rest_gives_no_frames(tmp_path: Path) -> None:
    lefts = [*[0.0] * 40, *np.linspace(0, 600, 60), *[600.0] * 40]
    numbers = chosen(tmp_path, pan(lefts))
    assert sum(number < 38 for number in numbers) <= 1 and sum(number > 101 for number in numbers) <= 1
    assert len(numbers) > 25


def test_the_sharpest_of_each_step_is_taken(tmp_path: Path) -> None:
    frames = pan(np.linspace(0, 700, 100))
    for number in range(0, 100, 2):
        frames[number] = cv2.blur(frames[number], (9, 1))  # as motion blurs
    numbers = chosen(tmp_path, frames, 20)
    assert len(numbers) <= 20
    assert sum(number % 2 for number in numbers) >= 0.9 * len(numbers)


def test_a_still_video_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=r"walk\.mp4: too little motion in 30 frames; walk around the object"):
        chosen(tmp_path, pan([5.0] * 30))


def test_choice_by_numbers() -> None:
    """Check against the definition: at most one frame of each step, apart, and the sharpest that may be taken."""
    random = np.random.default_rng(0)
    path = np.cumsum(random.random(500) * 0.01)
    sharpness = random.random(500)
    numbers = choose_frames(path, sharpness, 50)
    assert len(numbers) == 50, "the most, as the path would give more"
    step = (path[-1] - path[0]) / 50
    assert np.diff(path[numbers]).min() >= 0.4 * step
    assert sharpness[numbers].mean() > 0.75
    assert choose_frames(np.zeros(10), sharpness[:10], 50) == []
