"""Files that are not what their names say: pointers of Git LFS, web pages, empty downloads, videos, raw photographs."""

from __future__ import annotations

from pathlib import Path

from mgsr.errors import SceneError

# The suffixes of videos that are read, and of others.
VIDEO_SUFFIXES = (".mp4", ".mov", ".m4v", ".webm", ".mkv", ".3gp")
_OTHER_VIDEO_SUFFIXES = (".avi", ".mts", ".m2ts", ".wmv", ".insv")
RAW_SUFFIXES = (".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".orf", ".rw2", ".insp", ".360")

VIDEO_CURE = "convert it with `ffmpeg -i VIDEO -c:v libx264 -crf 15 VIDEO.mp4`, and give that alone"
VIDEO_ALONE = "give a video without photographs beside it, and frames of it are used"
RAW_CURE = "convert them to JPEG, PNG or TIFF, all with the same settings"

_LFS = b"version https://git-lfs.github.com/spec/"
_ANNEX = b"/annex/objects/"


def what_instead(path: Path) -> str | None:
    """Return the real kind of a misnamed file, with a remedy; None if nothing is odd."""
    try:
        with path.open("rb") as file:
            head = file.read(512)
    except OSError:
        return None
    if not head:
        return "is an empty file; copy or download it again"
    if head.startswith(_LFS):
        return "is a pointer of Git LFS, not the file itself; fetch the files with `git lfs pull`"
    if _ANNEX in head and len(head) < 512:
        return "is a pointer of git-annex, not the file itself; fetch the files with `git annex get .`"
    text = head.lstrip(b"\xef\xbb\xbf \t\r\n").lower()
    if text.startswith((b"<!doctype html", b"<html")):
        return "is a web page, not the file itself; download the file again, for example after logging in"
    return None


def require_content(path: Path) -> None:
    """Raise SceneError where a file's content does not match its name."""
    if path.is_file() and (odd := what_instead(path)):
        raise SceneError(f"{path.name} {odd}")


def is_video_name(path: Path) -> bool:
    """Return whether a file has the name of a video, whether it is read or not."""
    return path.suffix.lower() in (*VIDEO_SUFFIXES, *_OTHER_VIDEO_SUFFIXES)


def is_read_video_name(path: Path) -> bool:
    """Return whether a file has the name of a video of a kind that is read."""
    return path.suffix.lower() in VIDEO_SUFFIXES


def videos_below(folder: Path) -> list[Path]:
    """Return the videos in a folder and below it by their names, sorted, without hidden files."""
    files = (path for path in folder.rglob("*") if is_read_video_name(path) and path.is_file())
    return sorted(path for path in files if not path.name.startswith("."))
