"""A zipped scene, unpacked without letting it write anywhere else."""

from __future__ import annotations

import atexit
import shutil
import stat
import tempfile
import zipfile
import zlib
from pathlib import Path, PurePosixPath

from mgsr.errors import SceneError

# Far above any capture that a run could use; it stops archives that are made to fill the disk.
MAX_BYTES = 32 << 30
MAX_MEMBERS = 100_000

_JUNK = {"__MACOSX", ".DS_Store", "Thumbs.db"}


def unpack(archive: Path, target: Path | None = None) -> Path:
    """The folder with the archive's files: `target`, or else one that is removed when this process ends.

    Raises SceneError naming the member for absolute paths, '..', links, encrypted or damaged members.
    """
    try:
        with zipfile.ZipFile(archive) as opened:
            members = [member for member in opened.infolist() if not _is_junk(member)]
            places = [_checked_place(archive, member) for member in members]
            _check_size(archive, members)
            folder = target or _temporary_folder()
            for member, place in zip(members, places, strict=True):
                _write(archive, opened, member, folder / place)
    except (zipfile.BadZipFile, NotImplementedError) as error:
        raise SceneError(f"{archive.name}: not a zip archive that can be read: {error}; make it again") from error
    return folder


def _checked_place(archive: Path, member: zipfile.ZipInfo) -> PurePosixPath:
    name = member.filename.replace("\\", "/")
    place = PurePosixPath(name)
    if place.is_absolute() or ".." in place.parts or ":" in place.parts[0]:
        raise SceneError(f"{archive.name}: member {member.filename!r} points outside the archive; refused")
    kind = stat.S_IFMT(member.external_attr >> 16)
    if kind not in (0, stat.S_IFREG, stat.S_IFDIR):
        raise SceneError(f"{archive.name}: member {member.filename!r} is a link or a special file; put the file in")
    if member.flag_bits & 1:
        raise SceneError(f"{archive.name}: member {member.filename!r} is encrypted; archive it without a password")
    return place


def _check_size(archive: Path, members: list[zipfile.ZipInfo]) -> None:
    total = sum(member.file_size for member in members)
    if total > MAX_BYTES or len(members) > MAX_MEMBERS:
        raise SceneError(
            f"{archive.name}: unpacks to {len(members)} files of {total / 2**30:.1f} GiB; "
            f"at most {MAX_MEMBERS} files of {MAX_BYTES / 2**30:.0f} GiB are taken"
        )


def _write(archive: Path, opened: zipfile.ZipFile, member: zipfile.ZipInfo, place: Path) -> None:
    try:
        if member.is_dir():
            place.mkdir(parents=True, exist_ok=True)
            return
        place.parent.mkdir(parents=True, exist_ok=True)
        # zipfile never gives more bytes than the member declares, so _check_size holds for what is written.
        with opened.open(member) as source, open(place, "wb") as sink:
            shutil.copyfileobj(source, sink)
    except (zipfile.BadZipFile, zlib.error, EOFError, OSError) as error:
        raise SceneError(f"{archive.name}: member {member.filename!r} can't be unpacked: {error}") from error


def _is_junk(member: zipfile.ZipInfo) -> bool:
    return bool(_JUNK & set(PurePosixPath(member.filename).parts)) or not PurePosixPath(member.filename).parts


def _temporary_folder() -> Path:
    folder = Path(tempfile.mkdtemp(prefix="mgsr-scene-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder
