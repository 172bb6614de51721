"""Blender / NeRF-synthetic: transforms_train.json and transforms_test.json with camera-to-world poses, OpenGL axes."""

from __future__ import annotations

from pathlib import Path

from mgsr.data.capture import Capture, Format, Split
from mgsr.data.photo_files import SceneFolder
from mgsr.data.transforms import Frame, merged_frames, read_content, read_frames, refuse_doubles

_TRAIN, _TEST, _VAL = "transforms_train.json", "transforms_test.json", "transforms_val.json"


def recognises(root: Path) -> str | None:
    """Return transforms_train.json, if the folder has it."""
    return _TRAIN if (root / _TRAIN).is_file() else None


def read(folder: SceneFolder) -> Capture:
    """Read all training and test frames.

    Validation frames serve as test frames if the capture has no others; otherwise they are not used. Raises SceneError
    if two frames share a photograph, even if one is for training and the other for testing.
    """
    test = next((name for name in (_TEST, _VAL) if (folder.root / name).is_file()), None)
    frames = _frames(folder.root, _TRAIN, Split.TRAIN if test else None)
    frames += _frames(folder.root, test, Split.TEST) if test else []
    capture = read_frames(folder, _TRAIN, frames)
    refuse_doubles(capture.photos)
    return capture


def _frames(root: Path, name: str, split: Split | None) -> list[Frame]:
    frames = merged_frames(read_content(root / name), name)
    return [Frame(source, values, split) for source, values in frames]


FORMAT = Format("blender", f"{_TRAIN} (Blender, NeRF-synthetic)", recognises, read, rank=20)
