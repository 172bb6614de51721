"""Select the photographs of a capture that exist and have a valid camera."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from mgsr.data.capture import Capture, Photo
from mgsr.data.photo_files import SceneFolder
from mgsr.data.poses import check_intrinsics, check_pose, cuts_out, split_pose
from mgsr.errors import MissingPhotoError, SceneError, in_short


def usable_photos(capture: Capture, folder: SceneFolder) -> tuple[list[Photo], tuple[str, ...]]:
    """Return the photographs with checked intrinsics and rigid poses, and notes on omissions and changes.

    Raises SceneError with the first reason if the share of usable photographs is less than `capture.least_kept`.
    """
    if not capture.photos and not capture.lost:
        raise SceneError(f"{folder.root.name}: the scene has no views")
    checked: list[_Checked] = []
    lost = list(capture.lost)
    for photo in capture.photos:
        try:
            checked.append(_check(photo))
        except SceneError as error:
            lost.append(error)
    _require_enough(len(checked), lost, capture, folder)
    photos = [item.photo for item in checked]
    return photos, (*_notes_of_lost(lost, len(checked), capture.file), *_notes_of_changes(checked))


@dataclass(frozen=True)
class _Checked:
    """A photograph, and the scale that was divided out of its pose."""

    photo: Photo
    scale: float


def _check(photo: Photo) -> _Checked:
    K = check_intrinsics(photo.K, photo.size, photo.source)
    scale = split_pose(photo.cam_from_world, photo.source)[2]
    pose = check_pose(photo.cam_from_world, photo.source)
    return _Checked(replace(photo, K=K, cam_from_world=pose), scale)


def _require_enough(kept: int, lost: Sequence[SceneError], capture: Capture, folder: SceneFolder) -> None:
    total = kept + len(lost)
    if kept and kept >= capture.least_kept * total:
        return
    missing = capture.missing
    if 2 * len(missing) >= len(lost):
        raise SceneError(
            f"only {total - len(missing)} of the {total} photographs named by {capture.file} exist ({missing[0]}); "
            f"copy them anywhere into {folder.root.name}, with the names in {capture.file}"
        )
    reason = next(error for error in lost if not isinstance(error, MissingPhotoError))
    raise SceneError(f"{len(lost)} of {total} photographs cannot be used; the first: {reason}") from reason


def _notes_of_lost(lost: Sequence[SceneError], kept: int, file: str) -> tuple[str, ...]:
    total = kept + len(lost)
    missing = [error for error in lost if isinstance(error, MissingPhotoError)]
    broken = [error for error in lost if not isinstance(error, MissingPhotoError)]
    notes = []
    if missing:
        notes.append(f"{_counted(len(missing), total)} of {file} skipped: {in_short(missing[0])}")
    if broken:
        notes.append(f"{_counted(len(broken), total)} skipped: {in_short(broken[0])}")
    return tuple(notes)


def _notes_of_changes(checked: Sequence[_Checked]) -> tuple[str, ...]:
    notes = []
    scaled = [item.scale for item in checked if item.scale != 1]
    if scaled:
        poses = f"{_counted(len(scaled), len(checked))} with a scale in the pose"
        notes.append(f"{poses} ({1 / scaled[0]:.4g}); MGSR divides it out, which keeps positions and directions")
    parts = [item.photo for item in checked if cuts_out(item.photo.K, item.photo.size)]
    if parts:
        counted = _counted(len(parts), len(checked))
        notes.append(f"{counted} treated as crops of larger ones, because the principal point lies outside the image")
    return tuple(notes)


def _counted(some: int, total: int) -> str:
    return f"{some} of {total} photographs"
