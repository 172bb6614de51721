"""Choose frames of a video for structure from motion: sharp ones, at even steps of motion, and write them as images.

Motion is what features of the image move by. Where the camera rests, there is none, and no frame is taken twice.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mgsr.config.expert import FrameOptions
from mgsr.data.camera_search import Tell
from mgsr.data.video import Video, VideoLimits, open_video, picture_of
from mgsr.errors import SceneError

_FEWEST_FRAMES = 3  # from which cameras can be found

# Shares of the work: measuring, and then writing.
_MEASURED = 0.6


@dataclass(frozen=True)
class _Measured:
    """What a pass over a video measures.

    path [F]: the motion up to each frame, in diagonals of the image. sharpness [F].
    """

    path: np.ndarray
    sharpness: np.ndarray


def write_frames(
    video: Path,
    folder: Path,
    most: int,
    most_side: int,
    tell: Tell,
    limits: VideoLimits | None = None,
    options: FrameOptions = FrameOptions(),
) -> tuple[list[Path], str]:
    """Choose frames of a video and write them into a folder; return their files, and a line that sums up the choice.

    most: frames at most. most_side: pixels, to which larger frames are reduced. Raises SceneError for videos that can't
    be read or that show too little motion; ConfigError without PyAV; and what `tell` raises.
    """
    with open_video(video, limits) as opened:
        measured = _measure(opened, tell, options)
    chosen = choose_frames(measured.path, measured.sharpness, most, options)
    count = len(measured.path)
    if len(chosen) < _FEWEST_FRAMES:
        raise SceneError(
            f"{video.name}: too little motion in {count} frames; walk around the object while you film, slowly"
        )
    with open_video(video, limits) as opened:
        files = _write(opened, chosen, folder, most_side, tell, options)
    return files, f"{len(files)} of {count} frames of {video.name} are used, by motion and sharpness"


def choose_frames(
    path: np.ndarray, sharpness: np.ndarray, most: int, options: FrameOptions = FrameOptions()
) -> list[int]:
    """Return the indices of the sharpest frame of each step of motion, in order.

    path [F]: the motion up to each frame, which never falls; sharpness [F]; most: frames at most.
    """
    whole = float(path[-1] - path[0]) if len(path) else 0.0
    step = max(min(options.step, whole / options.min_frames), options.min_step, whole / most)
    count = int(whole / step + 1e-9)
    if count == 0:
        return []
    place = (path - path[0]) / (whole / count)  # in steps
    index = np.minimum(place.astype(int), count - 1)
    chosen: list[int] = []
    for number in range(count):
        there = np.flatnonzero(index == number)
        if chosen:
            there = there[place[there] - place[chosen[-1]] >= options.apart]
        if len(there):
            chosen.append(int(there[np.argmax(sharpness[there])]))
    return chosen


def _measure(video: Video, tell: Tell, options: FrameOptions) -> _Measured:
    """Measure motion and sharpness in one pass over the video."""
    import cv2

    follower = _Follower(options)
    path: list[float] = []
    sharpness: list[float] = []
    for frame in video.frames():
        grey = _grey(frame, video, options.sharpness_side)
        sharpness.append(_sharpness(grey, options.sigma))
        shrink = options.motion_side / max(grey.shape)
        small = cv2.resize(grey, None, fx=shrink, fy=shrink, interpolation=cv2.INTER_AREA) if shrink < 1 else grey
        path.append(follower.add(small))
        if video.frame_count:
            tell(_MEASURED * min(len(path) / video.frame_count, 1.0))
        else:
            tell(0.0)
    if not path:
        raise SceneError(f"{video.path.name}: there are no frames in it; copy it again")
    return _Measured(np.maximum.accumulate(np.array(path)), np.array(sharpness))


def _grey(frame: Any, video: Video, side: int) -> np.ndarray:
    """Return a frame [H,W] uint8 in grey, reduced to at most `side` pixels a side."""
    shrink = min(1.0, side / max(video.width, video.height))
    width, height = (max(2, round(side * shrink)) for side in (video.width, video.height))
    grey: np.ndarray = frame.to_ndarray(width=width, height=height, format="gray")
    return grey


def _sharpness(grey: np.ndarray, sigma: float) -> float:
    """Return the mean square of a grey image's fine detail in the direction that has least of it.

    Motion blurs one direction alone. Frames that show the same can be compared by it. grey [H,W] uint8; sigma: pixels.
    """
    import cv2

    fine = grey.astype(np.float32)
    fine -= cv2.GaussianBlur(fine, (0, 0), sigma)
    right, down = cv2.Sobel(fine, cv2.CV_32F, 1, 0), cv2.Sobel(fine, cv2.CV_32F, 0, 1)
    xx, yy, xy = (float((one * other).mean()) for one, other in ((right, right), (down, down), (right, down)))
    return (xx + yy) / 2 - float(np.hypot((xx - yy) / 2, xy))


class _Follower:
    """Adds up the motion of the image over a video, by features that are followed from frame to frame.

    Displacements count from the frame in which the features were found, so that noise does not add up to motion.
    """

    def __init__(self, options: FrameOptions) -> None:
        self._options = options
        self._before: Any = None
        self._first_places: Any = np.zeros((0, 1, 2), np.float32)
        self._places: Any = self._first_places
        self._found = 0
        self._path = 0.0

    def add(self, grey: np.ndarray) -> float:
        """Return the motion up to this frame [H,W] uint8, in diagonals of the image."""
        moved = self._moved(grey) if self._before is not None and self._found >= self._options.min_features else 0.0
        lost = len(self._places) < self._options.min_left * self._found
        total = self._path + (max(moved, self._options.stretch) if lost else moved)
        if self._found < self._options.min_features or lost or moved >= self._options.stretch:
            self._path = total
            self._find(grey)
        self._before = grey
        return total

    def _moved(self, grey: np.ndarray) -> float:
        """Follow the features into a frame; return the motion since they were found."""
        import cv2

        if not len(self._places):
            return 0.0
        places, there, _ = cv2.calcOpticalFlowPyrLK(self._before, grey, self._places, np.empty_like(self._places))
        kept = there.ravel() == 1
        self._places, self._first_places = places[kept], self._first_places[kept]
        if not kept.any():
            return 0.0
        apart = np.linalg.norm(self._places - self._first_places, axis=2)
        return float(np.quantile(apart, self._options.quantile) / np.hypot(*grey.shape))

    def _find(self, grey: np.ndarray) -> None:
        """Find features in a grey frame [H,W] uint8, and follow them from here on."""
        import cv2

        corners = cv2.goodFeaturesToTrack(grey, self._options.features, 0.01, 7)
        self._first_places = self._places = np.zeros((0, 1, 2), np.float32) if corners is None else corners
        self._found = len(self._places)


def _write(
    video: Video, chosen: Sequence[int], folder: Path, most_side: int, tell: Tell, options: FrameOptions
) -> list[Path]:
    """Write the chosen frames as JPEG, named by their number in the video."""
    import cv2

    folder.mkdir(parents=True, exist_ok=True)
    wanted, files = set(chosen), []
    for number, frame in enumerate(video.frames()):
        tell(_MEASURED + (1 - _MEASURED) * number / (chosen[-1] + 1))
        if number in wanted:
            file = folder / f"frame_{number:06d}.jpg"
            colors = picture_of(frame, most_side, options.knee)[..., ::-1]
            encoded = cv2.imencode(".jpg", colors, [cv2.IMWRITE_JPEG_QUALITY, options.quality])[1]
            file.write_bytes(encoded.tobytes())
            files.append(file)
        if number == chosen[-1]:
            break
    return files
