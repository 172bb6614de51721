"""Unpacks a stranger's archive: zip, tar or tar.gz, held to limits that count what really comes out."""

from __future__ import annotations

import gzip
import lzma
import tarfile
import zipfile
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import IO

from mgsr.data.files import IMAGE_SUFFIXES
from mgsr.data.images import image_size
from mgsr.errors import SceneError

# Small archives may be as compressible as they like: an empty mask packs to nothing.
RATIO_FROM = 64 << 20

_CHUNK = 1 << 20
_LONGEST_NAME = 200
_LONGEST_PATH = 1000
_JUNK = {"__MACOSX", ".DS_Store", "Thumbs.db"}
_DAMAGE = (zipfile.BadZipFile, tarfile.TarError, zlib.error, lzma.LZMAError, gzip.BadGzipFile, EOFError, ValueError)


class ArchiveError(SceneError):
    """The archive is refused; `code` says for what."""

    def __init__(self, code: str, message: str) -> None:
        super().__init__(message)
        self.code = code


@dataclass(frozen=True)
class Limits:
    """What is taken at most: files, bytes after unpacking, unpacked against packed bytes, pixels of one image."""

    members: int
    unpacked: int
    ratio: float
    pixels: int


@dataclass
class _Budget:
    """Counts what has come out of an archive of `packed` bytes."""

    limits: Limits
    packed: int
    members: int = 0
    unpacked: int = 0

    def member(self, name: str) -> None:
        self.members += 1
        if self.members > self.limits.members:
            raise ArchiveError(
                "archive_too_many_members",
                f"archive: member {name!r} is number {self.members}; at most {self.limits.members} are taken",
            )

    def bytes(self, name: str, count: int) -> None:
        self.unpacked += count
        if self.unpacked > self.limits.unpacked:
            raise ArchiveError(
                "archive_too_large",
                f"archive: with member {name!r} it unpacks to more than the limit of {self.limits.unpacked} bytes",
            )
        if self.unpacked > RATIO_FROM and self.unpacked > self.limits.ratio * self.packed:
            raise ArchiveError(
                "archive_ratio",
                f"archive: with member {name!r} it unpacks to over {self.limits.ratio:g} times its size, the limit",
            )


def unpack_archive(archive: Path, folder: Path, limits: Limits) -> None:
    """Write the archive's files under `folder`, which is made. Raises ArchiveError naming the member and the limit."""
    folder.mkdir(parents=True)
    budget = _Budget(limits, archive.stat().st_size)
    try:
        for name, source in _members(archive):
            budget.member(name)
            place = _place(name)
            if not place.parts or _JUNK & set(place.parts):
                continue
            if source is None:
                (folder / place).mkdir(parents=True, exist_ok=True)
            else:
                _write(source, folder / place, name, budget)
    except NotImplementedError as error:
        raise ArchiveError("archive_damaged", f"archive: packed in a way that is not known here: {error}") from error
    except _DAMAGE as error:
        raise ArchiveError("archive_damaged", f"archive: damaged: {error}; make and send it again") from error


def check_images(folder: Path, limits: Limits) -> None:
    """Raise ArchiveError for the first image with more pixels than the limit, judged by its header."""
    for path in sorted(folder.rglob("*")):
        if path.suffix.lower() not in IMAGE_SUFFIXES or not path.is_file():
            continue
        name = path.relative_to(folder).as_posix()
        width, height = image_size(path, "the archive")
        if width * height > limits.pixels:
            raise ArchiveError(
                "image_too_large", f"image {name}: {width}x{height} pixels; at most {limits.pixels} in one are taken"
            )


def _members(archive: Path) -> Iterator[tuple[str, IO[bytes] | None]]:
    """Name and content of each member, None for a folder. Refuses everything that is neither."""
    with archive.open("rb") as file:
        head = file.read(512)
    if head.startswith(b"PK"):
        yield from _zip_members(archive)
    elif head.startswith(b"\x1f\x8b"):
        yield from _tar_members(archive, "r|gz")
    elif head[257:262] == b"ustar":
        yield from _tar_members(archive, "r|")
    else:
        raise ArchiveError("archive_unsupported", "archive: neither zip nor tar nor tar.gz; send one of these")


def _zip_members(archive: Path) -> Iterator[tuple[str, IO[bytes] | None]]:
    with zipfile.ZipFile(archive) as opened:
        for member in opened.infolist():
            kind = (member.external_attr >> 16) & 0o170000
            if kind not in (0, 0o100000, 0o040000):
                raise _unsafe(member.filename, "is a link or a special file")
            if member.flag_bits & 1:
                raise _unsafe(member.filename, "is encrypted")
            if member.is_dir():
                yield member.filename, None
                continue
            with opened.open(member) as source:
                yield member.filename, source


def _tar_members(archive: Path, mode: str) -> Iterator[tuple[str, IO[bytes] | None]]:
    with tarfile.open(archive, mode) as opened:  # type: ignore[call-overload]
        for member in opened:
            if member.isdir():
                yield member.name, None
            elif member.isreg() and not member.issparse():
                yield member.name, opened.extractfile(member)
            else:
                raise _unsafe(member.name, "is a link or a special file")
            opened.members = []  # else the names of a million members pile up in memory


def _place(name: str) -> PurePosixPath:
    place = PurePosixPath(name.replace("\\", "/"))
    if place.is_absolute() or ".." in place.parts or any(":" in part for part in place.parts[:1]):
        raise _unsafe(name, "points outside the archive")
    if any(len(part.encode(errors="replace")) > _LONGEST_NAME for part in place.parts) or len(name) > _LONGEST_PATH:
        raise _unsafe(name[:80], f"has a name longer than {_LONGEST_NAME} bytes")
    if not name.isprintable():
        raise _unsafe(name, "has a name with control characters")
    return place


def _write(source: IO[bytes], path: Path, name: str, budget: _Budget) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        sink = path.open("xb")
    except (FileExistsError, NotADirectoryError) as error:
        raise _unsafe(name, "comes twice, or lies inside another file") from error
    with sink:
        while chunk := source.read(_CHUNK):
            budget.bytes(name, len(chunk))
            sink.write(chunk)


def _unsafe(name: str, what: str) -> ArchiveError:
    return ArchiveError("archive_unsafe_member", f"archive: member {name!r} {what}; leave it out or put the file in")
