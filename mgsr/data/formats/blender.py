"""Blender / NeRF-synthetic: transforms_train.json and transforms_test.json with camera-to-world poses, OpenGL axes."""

from __future__ import annotations

from pathlib import Path

from mgsr.data.capture import Capture, Format, Photo, Split
from mgsr.data.transforms import merged_frames, read_content, read_frame, refuse_doubles

_TRAIN, _TEST, _VAL = "transforms_train.json", "transforms_test.json", "transforms_val.json"


def recognises(root: Path) -> str | None:
    """transforms_train.json, if the folder has it."""
    return _TRAIN if (root / _TRAIN).is_file() else None


def read(root: Path) -> Capture:
    """All training and test frames. The validation frames are the test where there is no other, else unused.

    Raises SceneError where two frames, also a training and a test frame, have the same photograph.
    """
    test = next((name for name in (_TEST, _VAL) if (root / name).is_file()), None)
    train = _read_frames(root, _TRAIN, Split.TRAIN if test else None)
    photos = train + (_read_frames(root, test, Split.TEST) if test else [])
    refuse_doubles(photos)
    return Capture(photos)


def _read_frames(root: Path, name: str, split: Split | None) -> list[Photo]:
    frames = merged_frames(read_content(root / name), name)
    return [read_frame(root, source, frame, split) for source, frame in frames]


FORMAT = Format("blender", f"{_TRAIN} (Blender, NeRF-synthetic)", recognises, read, rank=20)
