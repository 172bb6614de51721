"""Videos for tests, encoded by PyAV."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

av = pytest.importorskip("av")

CODECS = {".mp4": "libx264", ".mov": "libx265", ".webm": "libvpx-vp9", ".mkv": "libx264"}
WIDTH, HEIGHT = 320, 240


def film(path: Path, frames: Iterable[Any], turn: int = 0, **tags: int) -> Path:
    """Write frames, arrays [H,W,3] uint8 or VideoFrames, as a video by the codec that usually goes with its suffix.

    turn: degrees, stored as the display matrix. tags: colour tags of the stream.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with av.open(str(path), "w") as container:
        stream: Any = None
        for number, frame in enumerate(frames):
            item = av.VideoFrame.from_ndarray(frame, format="rgb24") if isinstance(frame, np.ndarray) else frame
            if stream is None:
                stream = _stream(container, CODECS[path.suffix], item, turn, tags)
            item.pts, item.time_base = number, Fraction(1, 30)
            container.mux(stream.encode(item))
        container.mux(stream.encode())
    return path


def _stream(container: Any, codec: str, frame: Any, turn: int, tags: Mapping[str, int]) -> Any:
    options = {"crf": "6"} | ({"x265-params": "log-level=none:bframes=0"} if codec == "libx265" else {})
    stream = container.add_stream(codec, rate=30, options=options)
    stream.width, stream.height = frame.width, frame.height
    stream.pix_fmt = "yuv420p" if frame.format.name == "rgb24" else frame.format.name
    for name, value in tags.items():
        setattr(stream.codec_context, name, value)
    if turn:
        stream.set_display_rotation(turn)
    return stream


def texture(width: int = 1600, height: int = 600) -> np.ndarray:
    """Return a picture [H,W,3] of blobs in many colours."""
    noise = np.random.default_rng(0).integers(0, 256, (height // 10, width // 10, 3), dtype=np.uint8)
    blobs: np.ndarray = cv2.resize(noise, (width, height), interpolation=cv2.INTER_CUBIC)
    return blobs


def pan(lefts: Iterable[float]) -> list[np.ndarray]:
    """Return frames of a camera that looks at the texture with its left side at these columns."""
    picture = texture()
    return [picture[100 : 100 + HEIGHT, round(left) : round(left) + WIDTH].copy() for left in lefts]
