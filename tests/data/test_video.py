"""Videos held to OpenCV's reader and to the formulas of BT.2100, and hostile ones that must be refused."""

from __future__ import annotations

import json
import random
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from mgsr.data import video
from mgsr.data.video import VideoLimits, open_video, picture_of
from mgsr.errors import ConfigError, SceneError
from tests.data.films import HEIGHT, WIDTH, av, film, pan

LEFT_UP, LOW = (200, 100, 50), (30, 160, 220)


def picture() -> np.ndarray:
    image = np.full((HEIGHT, WIDTH, 3), 128, np.uint8)
    image[: HEIGHT // 2, : WIDTH // 2] = LEFT_UP
    image[HEIGHT // 2 :] = LOW
    return image


def first(path: Path, side: int = 1600) -> np.ndarray:
    with open_video(path) as opened:
        return picture_of(next(iter(opened.frames())), side)


def by_opencv(path: Path) -> np.ndarray:
    """Return the first frame [H,W,3], turned upright, by another reader."""
    reader = cv2.VideoCapture(str(path))
    there, frame = reader.read()
    reader.release()
    assert there
    return np.asarray(frame[..., ::-1])


@pytest.mark.parametrize("suffix", [".mp4", ".mov", ".webm", ".mkv"])
def test_usual_videos(tmp_path: Path, suffix: str) -> None:
    path = film(tmp_path / f"a{suffix}", [picture()] * 4)
    assert np.abs(first(path).astype(int) - picture()).mean() < 2
    with open_video(path) as opened:
        assert len(list(opened.frames())) == 4 and (opened.width, opened.height) == (WIDTH, HEIGHT)
    assert first(path, 160).shape == (120, 160, 3)


@pytest.mark.parametrize("turn", [90, 180, 270])
def test_frames_stand_upright(tmp_path: Path, turn: int) -> None:
    path = film(tmp_path / "a.mp4", [picture()] * 2, turn)
    ours, theirs = first(path), by_opencv(path)
    assert ours.shape == theirs.shape
    assert np.abs(ours.astype(int) - theirs).mean() < 4


def grey(signal: float) -> Any:
    """Return a 10-bit frame of one grey, of limited range (ITU-R BT.2100, table 9)."""
    frame = av.VideoFrame(64, 48, "yuv420p10le")
    for plane, value in zip(frame.planes, (round(64 + 876 * signal), 512, 512), strict=True):
        rows = np.full((plane.height, plane.line_size // 2), value, np.uint16)
        plane.update(rows.tobytes())
    return frame


# By hand: 203 cd/m2 is diffuse white, and 100 cd/m2 is 0.4926 of it; HLG's 0.5 is a twelfth of the scene's peak, of
# which diffuse white is 0.265. Linear 0.4926 and 0.3145 are 186 and 152 in sRGB.
@pytest.mark.parametrize(("curve", "signal", "expected"), [(16, 0.5081, 186), (18, 0.5, 152), (18, 0.0, 0)])
def test_hdr_is_shown_by_its_diffuse_white(tmp_path: Path, curve: int, signal: float, expected: int) -> None:
    tags = {"color_trc": curve, "color_primaries": 9, "colorspace": 9}
    path = film(tmp_path / "a.mov", [grey(signal)] * 2, **tags)
    assert np.abs(first(path)[24, 32].astype(int) - expected).max() <= 2


def test_brighter_hdr_light_keeps_its_order(tmp_path: Path) -> None:
    tags = {"color_trc": 18, "color_primaries": 9, "colorspace": 9}
    shown = [
        int(first(film(tmp_path / f"{i}.mov", [grey(signal)] * 2, **tags))[24, 32, 0])
        for i, signal in enumerate((0.6, 0.7, 0.75, 0.85, 1.0))
    ]
    assert shown == sorted(set(shown)) and shown[2] > 235 and shown[-1] <= 255


def refused(path: Path, message: str, limits: VideoLimits | None = None) -> None:
    with pytest.raises(SceneError, match=message), open_video(path, limits) as opened:
        for _ in opened.frames():
            continue


def test_what_exceeds_the_limits(tmp_path: Path) -> None:
    path = film(tmp_path / "a.mp4", pan(range(20)))
    refused(path, r"a\.mp4: expected at most 10 frames, got 20 or more; cut it shorter", VideoLimits(frames=10))
    refused(path, "is damaged|expected frames of 1 to 1000 pixels, got ", VideoLimits(pixels=1000))
    web = film(tmp_path / "a.webm", pan(range(20)))
    refused(web, "expected at most 10 frames, got 11 or more", VideoLimits(frames=10))
    refused(web, "is damaged|expected frames of 1 to 1000 pixels, got ", VideoLimits(pixels=1000))


def test_files_that_are_no_videos(tmp_path: Path) -> None:
    (tmp_path / "playlist.mp4").write_text("#EXTM3U\n#EXTINF:1,\n/etc/passwd\n")
    (tmp_path / "concat.mp4").write_text("ffconcat version 1.0\nfile /etc/passwd\n")
    (tmp_path / "page.mp4").write_text("<!doctype html><title>Sign in</title>")
    (tmp_path / "empty.mp4").touch()
    (tmp_path / "a.avi").write_bytes(b"RIFF\0\0\0\0AVI LIST" + bytes(99))
    (tmp_path / "bare.mp4").write_bytes(b"\0\0\0\x18ftypisom\0\0\2\0isommp42" + bytes(99))
    for name, message in (
        ("playlist.mp4", "expected an MP4, MOV, WebM or Matroska video"),
        ("concat.mp4", "expected an MP4"),
        ("page.mp4", "is a web page"),
        ("empty.mp4", "is an empty file"),
        ("a.avi", "expected an MP4"),
        ("bare.mp4", r"damaged or cut off|has no video stream"),
    ):
        refused(tmp_path / name, message)


def test_other_codecs_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.mp4"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=30)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        container.mux(stream.encode(av.VideoFrame.from_ndarray(np.zeros((48, 64, 3), np.uint8), format="rgb24")))
        container.mux(stream.encode())
    refused(path, "expected H.264, HEVC, VP8, VP9 or AV1 video, got the codec mpeg4; convert it with `ffmpeg")


@pytest.mark.parametrize("suffix", [".mp4", ".webm"])
@pytest.mark.parametrize("share", [0.2, 0.5, 0.8])
def test_a_cut_off_video_is_refused(tmp_path: Path, suffix: str, share: float) -> None:
    whole = film(tmp_path / f"whole{suffix}", pan(range(0, 120, 2))).read_bytes()
    cut = tmp_path / f"cut{suffix}"
    cut.write_bytes(whole[: int(share * len(whole))])
    refused(cut, "damaged or cut off")


def test_an_index_of_more_than_the_file_is_refused(tmp_path: Path) -> None:
    """Check a video whose index comes first, as for the web, so that FFmpeg opens it without its end."""
    path = tmp_path / "fast.mp4"
    with av.open(str(path), "w", options={"movflags": "faststart"}) as container:
        stream = container.add_stream("libx264", rate=30)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        for frame in pan(range(0, 120, 2)):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        container.mux(stream.encode())
    path.write_bytes(path.read_bytes()[:-2000])
    refused(path, r"the video is damaged or cut off: it declares \d+ bytes, but has \d+; copy it again")


def test_without_pyav_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = film(tmp_path / "a.mp4", pan(range(3)))
    monkeypatch.setitem(sys.modules, "av", None)
    with (
        pytest.raises(ConfigError, match=r"needs PyAV; install it with `pip install 'mgsr\[poses\]'`"),
        open_video(path),
    ):
        raise AssertionError("it opened")


READ_ALL = """
import json, resource, sys
from pathlib import Path
from mgsr.data.video import open_video, picture_of
from mgsr.errors import SceneError
ends = {"read": 0, "refused": 0}
for path in sorted(Path(sys.argv[1]).iterdir()):
    try:
        with open_video(path) as video:
            for frame in video.frames():
                picture_of(frame, 200)
        ends["read"] += 1
    except SceneError:
        ends["refused"] += 1
print(json.dumps(ends | {"mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024}))
"""


@pytest.mark.slow
def test_damaged_videos_are_read_or_refused_in_bounded_memory(tmp_path: Path) -> None:
    """Check 100 videos with random damage, some of it in their headers' sizes, in a process of their own."""
    choose = random.Random(0)
    whole = [film(tmp_path / f"whole/a{suffix}", pan(range(12))).read_bytes() for suffix in (".mp4", ".webm", ".mov")]
    folder = tmp_path / "damaged"
    folder.mkdir()
    for number in range(100):
        data = bytearray(whole[number % 3])
        for _ in range(choose.choice((1, 10, 200))):
            place = choose.randrange(12, 1200) if number % 2 else choose.randrange(12, len(data))
            data[min(place, len(data) - 1)] = choose.choice((0, 255, choose.randrange(256)))
        (folder / f"{number}.mp4").write_bytes(data)
    started_at = time.monotonic()
    ran = subprocess.run([sys.executable, "-c", READ_ALL, str(folder)], capture_output=True, text=True, timeout=250)
    assert ran.returncode == 0, ran.stderr[-2000:]
    ends = json.loads(ran.stdout.splitlines()[-1])
    assert ends["read"] + ends["refused"] == 100 and ends["refused"] > 10
    assert ends["mib"] < 1500 and time.monotonic() - started_at < 240


def test_a_bomb_by_its_dimensions_is_refused_before_a_frame_is_made(tmp_path: Path) -> None:
    """Check a video whose bitstream declares 16384x16384 pixels: a file of a few kilobytes."""
    path = tmp_path / "bomb.webm"
    huge = 16384
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libvpx-vp9", rate=30, options={"crf": "63"})
        stream.width = stream.height = 64
        stream.pix_fmt = "yuv420p"
        container.mux(stream.encode(av.VideoFrame.from_ndarray(np.zeros((64, 64, 3), np.uint8), format="rgb24")))
        container.mux(stream.encode())
    data = path.read_bytes()
    # PixelWidth and PixelHeight of Matroska (RFC 9559, 5.1.4.1.28.6): IDs B0 and BA with sizes of one byte.
    for name in (b"\xb0\x81\x40", b"\xba\x81\x40"):
        assert data.count(name) == 1
        data = data.replace(name, name[:1] + b"\x82" + huge.to_bytes(2, "big"))
    path.write_bytes(data)
    refused(path, "damaged|pixels")
    assert video.VideoLimits().pixels < huge * huge
