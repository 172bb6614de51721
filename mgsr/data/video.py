"""Open videos safely with FFmpeg (PyAV), and convert their frames to upright 8-bit sRGB pictures.

Only MP4, QuickTime, Matroska and WebM with the usual codecs are opened. The first bytes of a file tell its container.
Other formats that FFmpeg supports can refer to files and addresses, which it would then read.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mgsr.config.expert import FrameOptions
from mgsr.data.images import linear_to_srgb, reduce_area, to_uint8
from mgsr.data.odd_files import what_instead
from mgsr.errors import ConfigError, SceneError, in_short
from mgsr.parallel import core_count

_CODECS = ("h264", "hevc", "vp8", "vp9", "av1")
_MOST_THREADS = 8

# A Matroska video is cut off if its last frame comes before this share of its length, less these seconds.
_LEAST_SEEN, _TAIL = 0.95, 0.2

# Colour codes of ITU-T H.273.
_BT601, _BT709, _BT2020 = (5, 6), 1, 9
_PQ, _HLG = 16, 18
_UNKNOWN = 2
# A video that does not name its colour matrix has BT.709 from this height on, else BT.601.
_HIGH_DEFINITION = 720

# The light of diffuse white, 203 cd/m2, as a share of the signal's peak (ITU-R BT.2408). The peak is 1000 cd/m2 in HLG,
# where the share is of scene light, and 10,000 cd/m2 in PQ.
_HLG_WHITE = 0.265
_PQ_WHITE = 0.0203

# Linear light of BT.2020 to that of sRGB (ITU-R BT.2087).
_SRGB_FROM_BT2020 = np.array(
    [[1.6605, -0.5876, -0.0728], [-0.1246, 1.1329, -0.0083], [-0.0182, -0.1006, 1.1187]], np.float32
)


@dataclass(frozen=True)
class VideoLimits:
    """Limits of a video: pixels per frame, and frames. The defaults are 8K, and 20 minutes at 30 Hz."""

    pixels: int = 1 << 25
    frames: int = 36_000


class Video:
    """An open video.

    path: its file. width, height: the size of its frames in pixels, as stored. frame_count: the number of frames that
    the file declares, 0 if it declares none.
    """

    def __init__(self, path: Path, container: Any, limits: VideoLimits) -> None:
        self.path, self._container, self._limits = path, container, limits
        self._stream = container.streams.video[0]
        context = self._stream.codec_context
        self.width, self.height = int(context.width), int(context.height)
        self.frame_count = max(0, int(self._stream.frames))

    def frames(self) -> Iterator[Any]:
        """Yield every frame in order, as av.VideoFrame.

        Raises SceneError if the video is damaged, cut off, changes its size or has too many frames.
        """
        import av

        count, end = 0, 0.0
        try:
            for frame in self._container.decode(self._stream):
                count += 1
                end = max(end, frame.time or 0.0)
                if count > self._limits.frames:
                    raise _too_long(self.path, count, self._limits)
                if (frame.width, frame.height) != (self.width, self.height):
                    raise SceneError(f"{self.path.name}: its frames change their size; record it again")
                yield frame
        except (av.FFmpegError, ValueError, EOFError) as error:
            raise _damaged(self.path, f"after {count} frames: {in_short(error)}") from error
        whole = (self._container.duration or 0) / av.time_base
        # FFmpeg takes the end of a Matroska file for the end of the video, wherever it comes.
        if "matroska" in self._container.format.name and end < _LEAST_SEEN * whole - _TAIL:
            raise _damaged(self.path, f"it declares {whole:.1f} s, but ends after {end:.1f} s")


@contextmanager
def open_video(path: Path, limits: VideoLimits | None = None) -> Iterator[Video]:
    """Open a video for one pass over its frames.

    Raises SceneError for files that are not supported videos, are damaged, or declare more than the limits allow.
    `Video.frames` checks the actual number of frames. Raises ConfigError without PyAV.
    """
    kind = _container_kind(path)
    if importlib.util.find_spec("av") is None:
        raise ConfigError(f"{path.name}: reading videos needs PyAV; install it with `pip install 'mgsr[poses]'`")
    import av

    limits = limits or VideoLimits()
    # Logging is off because FFmpeg's threads would wait for Python's lock to log, while Python waits for the threads.
    # Errors arrive as exceptions anyway.
    av.logging.set_level(None)
    # FFmpeg applies max_pixels before it allocates a frame, even while it probes the streams.
    bounds = {"max_pixels": str(limits.pixels)}
    try:
        with av.open(str(path), format=kind, options={**bounds, "protocol_whitelist": "file"}) as container:
            _check_streams(path, container)
            stream = container.streams.video[0]
            stream.codec_context.options = bounds
            stream.thread_type = "AUTO"
            stream.codec_context.thread_count = min(_MOST_THREADS, core_count(None))
            video = Video(path, container, limits)
            _check_declared(video, container, limits)
            yield video
    except (av.FFmpegError, ValueError, EOFError) as error:
        raise _damaged(path, in_short(error)) from error


def suffix_by_content(path: Path) -> str | None:
    """Return the suffix that fits a video's first bytes, whatever its name, or None for other files."""
    return {"mov": ".mp4", "matroska": ".mkv", None: None}[_kind(path)]


def _kind(path: Path) -> str | None:
    """Return FFmpeg's name of a file's container (ISO/IEC 14496-12, 4.3; RFC 8794, 11.1), or None for others."""
    with path.open("rb") as file:
        head = file.read(12)
    if head[4:8] in (b"ftyp", b"moov", b"wide", b"mdat"):
        return "mov"
    return "matroska" if head.startswith(b"\x1a\x45\xdf\xa3") else None


def _container_kind(path: Path) -> str:
    if not path.is_file():
        raise SceneError(f"{path}: no such file")
    if odd := what_instead(path):
        raise SceneError(f"{path.name} {odd}")
    kind = _kind(path)
    if kind is None:
        raise SceneError(
            f"{path.name}: expected an MP4, MOV, WebM or Matroska video, but it begins like none of them; convert it "
            "with `ffmpeg -i VIDEO -c:v libx264 -crf 15 VIDEO.mp4`"
        )
    return kind


def _check_streams(path: Path, container: Any) -> None:
    """Raise SceneError if a file has no video stream, or one with an unsupported codec."""
    if not container.streams.video:
        raise SceneError(f"{path.name}: the file has no video stream, perhaps only sound; pass the video's own file")
    context = container.streams.video[0].codec_context
    name = None if context is None else context.name.removeprefix("lib").removesuffix("-vp9")
    known = {"dav1d": "av1", "vpx": "vp9"}
    if known.get(name or "", name) not in _CODECS:
        cure = "convert it with `ffmpeg -i VIDEO -c:v libx264 -crf 15 VIDEO.mp4`"
        raise SceneError(f"{path.name}: expected H.264, HEVC, VP8, VP9 or AV1 video, got the codec {name}; {cure}")


def _check_declared(video: Video, container: Any, limits: VideoLimits) -> None:
    """Raise SceneError if a video declares more than the limits allow, or more bytes than its file has."""
    if video.width * video.height > limits.pixels or min(video.width, video.height) < 1:
        raise SceneError(
            f"{video.path.name}: expected frames of 1 to {limits.pixels} pixels, got {video.width}x{video.height}"
        )
    if video.frame_count > limits.frames:
        raise _too_long(video.path, video.frame_count, limits)
    entries = container.streams.video[0].index_entries
    end = max((entry.pos + entry.size for entry in entries), default=0) if len(entries) else 0
    if end > (size := video.path.stat().st_size):
        raise _damaged(video.path, f"it declares {end} bytes, but has {size}")


def _too_long(path: Path, count: int, limits: VideoLimits) -> SceneError:
    return SceneError(f"{path.name}: expected at most {limits.frames} frames, got {count} or more; cut it shorter")


def _damaged(path: Path, reason: str) -> SceneError:
    return SceneError(f"{path.name}: the video is damaged or cut off: {reason}; copy it again")


def picture_of(frame: Any, most_side: int, knee: float = FrameOptions().knee) -> np.ndarray:
    """Return a frame as an upright 8-bit sRGB picture [H,W,3] of at most `most_side` pixels a side.

    In HLG and PQ (ITU-R BT.2100), diffuse white becomes white. Light brighter than `knee` times that white is
    compressed.
    """
    matrix = _matrix(frame)
    if frame.color_trc in (_PQ, _HLG):
        signal = frame.to_ndarray(format="rgb48le", src_colorspace=matrix) / np.float32(65535)
        wide = frame.color_primaries == _BT2020
        colors = _as_srgb(signal.astype(np.float32), int(frame.color_trc), wide, knee)
    else:
        colors = frame.to_ndarray(format="rgb24", src_colorspace=matrix)
    shrink = most_side / max(colors.shape[:2])
    if shrink < 1:
        height, width = (max(1, round(side * shrink)) for side in colors.shape[:2])
        colors = to_uint8(reduce_area(colors, width, height))
    return np.ascontiguousarray(np.rot90(colors, round(frame.rotation / 90)))


def _matrix(frame: Any) -> int:
    """Return the code of a frame's colour matrix, in swscale's and H.273's numbering."""
    stated = int(frame.colorspace)
    if stated in (0, _UNKNOWN):
        return _BT709 if frame.height >= _HIGH_DEFINITION else _BT601[0]
    return stated


def _as_srgb(signal: np.ndarray, curve: int, wide: bool, knee: float) -> np.ndarray:
    """Convert an HDR signal [H,W,3], 0..1, to 8-bit sRGB. wide: whether its primaries are those of BT.2020."""
    light = _pq_light(signal) / _PQ_WHITE if curve == _PQ else _hlg_light(signal) / _HLG_WHITE
    if wide:
        light = light @ _SRGB_FROM_BT2020.T
    light = np.maximum(light, 0)
    over = np.maximum(light - knee, 0)
    bent = knee + (1 - knee) * over / (over + 1 - knee)  # continues with slope 1 at the knee, and approaches 1
    return to_uint8(255 * linear_to_srgb(np.where(light < knee, light, bent)))


def _hlg_light(signal: np.ndarray) -> np.ndarray:
    """Return the scene light 0..1 of an HLG signal 0..1 (ITU-R BT.2100, table 5)."""
    a, b, c = 0.17883277, 0.28466892, 0.55991073
    return np.where(signal <= 0.5, signal**2 / 3, (np.exp((signal - c) / a) + b) / 12)


def _pq_light(signal: np.ndarray) -> np.ndarray:
    """Return the display light, 0..1 of 10,000 cd/m2, of a PQ signal 0..1 (ITU-R BT.2100, table 4)."""
    m1, m2 = 2610 / 16384, 2523 / 4096 * 128
    c1, c2, c3 = 3424 / 4096, 2413 / 4096 * 32, 2392 / 4096 * 32
    power = signal ** (1 / m2)
    light: np.ndarray = (np.maximum(power - c1, 0) / (c2 - c3 * power)) ** (1 / m1)
    return light
