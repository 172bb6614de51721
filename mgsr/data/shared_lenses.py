"""Group photographs taken with the same camera and lens, so that they share a calibration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath

from mgsr.data.camera_tags import CameraTags

# The most cameras that one line names.
_MOST_NAMED = 4


@dataclass(frozen=True)
class PhotoFile:
    """A photograph. name: its path relative to the folder of photographs. size: width and height as stored."""

    name: str
    size: tuple[int, int]
    tags: CameraTags


@dataclass(frozen=True)
class SharedLens:
    """Photographs that share a lens, at least one."""

    shots: tuple[PhotoFile, ...]

    @property
    def tags(self) -> CameraTags:
        """Return the EXIF data on the photographs' camera."""
        return self.shots[0].tags

    @property
    def size(self) -> tuple[int, int]:
        """Return the photographs' width and height."""
        return self.shots[0].size


def share_lenses(shots: Sequence[PhotoFile]) -> list[SharedLens]:
    """Group photographs by camera, in the order in which the cameras first appear.

    Photographs share a lens if they have the same size and EXIF (maker, model, lens, body, focal lengths, digital
    zoom). The camera's orientation does not matter, as sizes refer to the stored pixels. Video frames and pictures from
    messengers have no such EXIF. They share a lens if size and folder are the same, as rigs have one folder per camera.
    """
    groups: dict[tuple[CameraTags, tuple[int, int], str], list[PhotoFile]] = {}
    for shot in shots:
        folder = "" if shot.tags.known else str(PurePosixPath(shot.name).parent)
        groups.setdefault((shot.tags, shot.size, folder), []).append(shot)
    return [SharedLens(tuple(group)) for group in groups.values()]


def describe_lenses(lenses: Sequence[SharedLens]) -> str:
    """Describe the cameras and their number in one line for the user."""
    if len(lenses) == 1:
        return f"one camera: {_label(lenses[0])}"
    named = [f"{_detailed(lens)} ({_counted(len(lens.shots))})" for lens in lenses[:_MOST_NAMED]]
    more = f"; and {len(lenses) - _MOST_NAMED} more" if len(lenses) > _MOST_NAMED else ""
    return f"{len(lenses)} cameras: {'; '.join(named)}{more}"


def _label(lens: SharedLens) -> str:
    size = f"{lens.size[0]}x{lens.size[1]}"
    return f"{lens.tags.camera}, {size}" if lens.tags.camera else size


def _detailed(lens: SharedLens) -> str:
    """Return the lens's label with its folder or focal length, which distinguishes cameras of the same name."""
    folder = PurePosixPath(lens.shots[0].name).parent
    if not lens.tags.known and folder.name:
        return f"{folder}, {_label(lens)}"
    return _label(lens) if lens.tags.focal is None else f"{_label(lens)} at {lens.tags.focal:.3g} mm"


def _counted(count: int) -> str:
    return "1 photograph" if count == 1 else f"{count} photographs"
