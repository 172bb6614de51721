"""Unpack an archived scene safely: nothing lands outside the target folder, fills the disk or stays behind."""

from __future__ import annotations

import atexit
import errno
import gzip
import lzma
import os
import shutil
import stat
import struct
import tarfile
import tempfile
import unicodedata
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import IO, Any

from mgsr.errors import ArchiveError, SceneError, in_short

ARCHIVE_SUFFIXES = (".zip", ".tar", ".tar.gz", ".tgz", ".tar.zst", ".tzst", ".7z", ".rar")

# The bytes at a zip's end that hold its end records and the longest comment.
_ZIP_END = (1 << 16) + 128

# Unpacked bytes below which the compression ratio is not checked (masks compress well).
RATIO_FROM = 64 << 20

_LONGEST_NAME = 255
_LONGEST_PATH = 1000
_CHUNK = 1 << 20
# Only headers lie between two files of a tar stream; a longer gap was made to fill the memory.
_HEADER_BYTES = 4 << 20
_JUNK = {"__MACOSX", ".DS_Store", "Thumbs.db"}
_APPLE_DOUBLE = "._"  # prefix of the files that macOS adds beside others

# The first bytes of other kinds of archives.
_OTHERS = {b"BZh": "bzip2", b"\xfd7zXZ\0": "xz", b"7z\xbc\xaf\x27\x1c": "7z", b"Rar!\x1a\x07": "RAR"}

_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA)
_METHOD_NAMES = {9: "Deflate64", 93: "Zstandard", 95: "XZ", 98: "PPMd"}  # APPNOTE.TXT 4.4.5

# The error numbers of a full disk.
_NO_SPACE = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_DAMAGE = (
    zipfile.BadZipFile,
    tarfile.TarError,
    zlib.error,
    lzma.LZMAError,
    gzip.BadGzipFile,
    EOFError,
    ValueError,
    RuntimeError,
    OverflowError,
    struct.error,
    KeyError,
)


@dataclass(frozen=True)
class ArchiveLimits:
    """The most that an archive may hold: files, bytes after unpacking, and the ratio of unpacked to packed bytes.

    The defaults are far above any capture that a run could use. They stop archives made to fill the disk.
    """

    members: int = 100_000
    unpacked: int = 32 << 30
    ratio: float = 200.0  # photographs hardly shrink


@dataclass(frozen=True)
class _Member:
    """A file of an archive and how to read it, or a folder (None)."""

    name: str
    open: Callable[[], IO[bytes]] | None


def unpack(archive: Path, target: Path | None = None, limits: ArchiveLimits | None = None) -> Path:
    """Unpack an archive and return the folder that holds its files.

    target: the folder to unpack to, which must be empty; None: a temporary folder that is removed when this process
    ends. The content decides between zip, tar, tar.gz and tar.zst. Files that macOS and Windows add beside the user's
    own are left out. After an error nothing is left behind.

    Raises ArchiveError, which names the member and the limit:

    - for names that are absolute, too long or repeated (also with different case), or have '..' or control characters;
    - for links and devices;
    - for encrypted or damaged members;
    - for archives that unpack to more than the limits, counted in bytes really written;
    - for other kinds of archives.

    Raises OSError, which names the folder, if the disk is full.
    """
    folder = target or temporary_folder("mgsr-scene-") / archive_stem(archive)  # messages name a scene after its folder
    if folder.is_dir() and any(folder.iterdir()):
        raise SceneError(f"{folder}: expected an empty folder to unpack {archive.name} into; choose another folder")
    folder.mkdir(parents=True, exist_ok=True)
    try:
        budget = _Budget(archive, limits or ArchiveLimits())
        with _opened(budget) as members:
            _write_all(budget, members, folder)
    except BaseException as error:
        shutil.rmtree(folder if target else folder.parent, ignore_errors=True)
        if target is None and isinstance(error, OSError) and error.errno in _NO_SPACE:
            cure = "free some space there, or set TMPDIR to a folder with more"
            raise OSError(error.errno, f"{error.strerror}: {archive.name} unpacks to {folder}; {cure}") from error
        if _is_damage(error):
            text = f"{archive.name}: the file is damaged or not an archive: {in_short(error)}; create it again"
            raise ArchiveError("archive_damaged", text) from error
        raise
    return folder


def _is_damage(error: BaseException) -> bool:
    """Return whether an error comes from the archive's content, and not from the disk or this program."""
    # A damaged archive can make zipfile seek to a place before the file's beginning.
    return isinstance(error, _DAMAGE) or (isinstance(error, OSError) and error.errno == errno.EINVAL)


def archive_stem(path: Path) -> str:
    """Return the archive's file name without its archive suffix."""
    suffix = next((end for end in sorted(ARCHIVE_SUFFIXES, key=len)[::-1] if path.name.lower().endswith(end)), "")
    return path.name[: len(path.name) - len(suffix)] or path.name


@contextmanager
def _opened(budget: _Budget) -> Iterator[Iterator[_Member]]:
    archive = budget.archive
    with archive.open("rb") as file:
        head = file.read(tarfile.BLOCKSIZE)
        file.seek(0)
        if head.startswith(b"PK"):
            budget.check_declared(_declared_count(file))
            with zipfile.ZipFile(file) as opened:
                yield _zip_members(archive, opened)
        elif head.startswith(b"\x1f\x8b"):
            with gzip.GzipFile(fileobj=file) as plain:
                yield _tar_members(archive, plain)
        elif head.startswith(b"\x28\xb5\x2f\xfd"):
            yield _tar_members(archive, _zstd_reader(file))
        elif head[257:262] == b"ustar" or _is_old_tar(head):
            yield _tar_members(archive, file)
        else:
            other = next((name for begin, name in _OTHERS.items() if head.startswith(begin)), None)
            text = "expected a folder or an archive (.zip, .tar, .tar.gz or .tar.zst)"
            text += f", got {other}; unpack it and archive its folder as .zip or .tar.gz" if other else ""
            raise ArchiveError("archive_unsupported", f"{archive.name}: {text}")


def _is_old_tar(head: bytes) -> bool:
    """Return whether the first header's checksum is valid, the only mark of a Unix V7 tar."""
    try:
        tarfile.TarInfo.frombuf(head, "utf-8", "surrogateescape")
    except tarfile.HeaderError:
        return False
    return True


def _declared_count(file: IO[bytes]) -> int:
    """Return how many members a zip declares, or 0 if it declares none (APPNOTE.TXT 4.3.14 and 4.3.16).

    The file is left at its beginning.
    """
    size = file.seek(0, os.SEEK_END)
    file.seek(max(size - _ZIP_END, 0))
    tail = file.read()
    file.seek(0)
    end = tail.rfind(b"PK\5\6")
    if end < 0 or len(tail) < end + 12:
        return 0
    count: int = struct.unpack_from("<H", tail, end + 10)[0]
    record = end - 76  # with its locator, where the count needs more than 16 bits
    if count == 0xFFFF and record >= 0 and tail[record : record + 4] == b"PK\6\6":
        count = struct.unpack_from("<Q", tail, record + 32)[0]
    return count


def _zstd_reader(file: IO[bytes]) -> Any:
    import zstandard  # imported here, because few archives need it

    # 128 MiB is the window that the format asks every decoder to support.
    return _Zstd(zstandard.ZstdDecompressor(max_window_size=1 << 27).stream_reader(file))


class _Zstd:
    """Reads zstd and raises the same errors as the other archive readers."""

    def __init__(self, stream: Any) -> None:
        self._stream = stream

    def read(self, count: int) -> bytes:
        """Read at most `count` bytes. Raises EOFError for damaged data."""
        import zstandard

        try:
            data: bytes = self._stream.read(count)
        except zstandard.ZstdError as error:
            raise EOFError(str(error)) from error
        return data


class _Gauge:
    """A stream that limits the number of bytes before the next file's content."""

    def __init__(self, stream: Any) -> None:
        self._stream = stream
        self.left: float = _HEADER_BYTES

    def read(self, count: int) -> bytes:
        """Read at most `count` bytes. Raises tarfile.ReadError for a header that is too long."""
        data: bytes = self._stream.read(count)
        self.left -= len(data)
        if self.left < 0:
            raise tarfile.ReadError(f"a header exceeds {_HEADER_BYTES} bytes")
        return data


def _zip_members(archive: Path, opened: zipfile.ZipFile) -> Iterator[_Member]:
    for member in opened.infolist():
        kind = stat.S_IFMT(member.external_attr >> 16)
        if kind not in (0, stat.S_IFREG, stat.S_IFDIR):
            raise _refused(archive, member.filename, "is a link or a special file; archive the file itself")
        if member.flag_bits & 1:
            raise _refused(archive, member.filename, "is encrypted; archive it without a password")
        # zipfile cuts names at a NUL byte; the rest was meant for another reader.
        if "\0" in member.orig_filename:
            raise _refused(archive, member.orig_filename, "has control characters in its name; rename it")
        if member.compress_type not in _METHODS:
            method = f"{member.compress_type} ({_METHOD_NAMES.get(member.compress_type, 'unknown')})"
            text = f"uses compression method {method}, which MGSR does not read; use Deflate, or create a .tar.gz"
            raise _refused(archive, member.filename, text, "archive_unsupported")
        yield _Member(member.filename, None if member.is_dir() else lambda member=member: opened.open(member))  # type: ignore[misc]


def _tar_members(archive: Path, stream: Any) -> Iterator[_Member]:
    gauge = _Gauge(stream)
    with tarfile.open(fileobj=gauge, mode="r|") as opened:  # type: ignore[call-overload]
        for member in opened:
            opened.members = []  # otherwise the names of many members would fill the memory
            if member.isdir():
                yield _Member(member.name, None)
            elif member.isreg() and not member.issparse():
                gauge.left = float("inf")
                yield _Member(member.name, lambda member=member: opened.extractfile(member))  # type: ignore[misc]
            else:
                text = (
                    "is a link or a special file; archive the file itself (GNU tar: --dereference --hard-dereference)"
                )
                raise _refused(archive, member.name, text)
            gauge.left = _HEADER_BYTES


def _write_all(budget: _Budget, members: Iterator[_Member], folder: Path) -> None:
    archive = budget.archive
    taken: dict[str, str] = {}
    for member in members:
        budget.count_member(member.name)
        place = _checked_place(archive, member.name)
        if not place.parts or any(part in _JUNK or part.startswith(_APPLE_DOUBLE) for part in place.parts):
            continue
        if member.open is None:
            _make_folder(archive, member.name, folder / place)
            continue
        other = taken.setdefault(str(place).casefold(), member.name)
        if other is not member.name:
            raise _refused(
                archive, member.name, f"has the same name as {other!r}, except perhaps for case; rename one of them"
            )
        _write(budget, member, folder / place)


def _checked_place(archive: Path, text: str) -> PurePosixPath:
    name = text.replace("\\", "/")
    place = PurePosixPath(name)
    if place.is_absolute() or ".." in place.parts or (place.parts and ":" in place.parts[0]):
        raise _refused(archive, text, "points outside the archive; rename it")
    if len(name) > _LONGEST_PATH or any(len(os.fsencode(part)) > _LONGEST_NAME for part in place.parts):
        raise _refused(archive, text[:80], f"has a name longer than {_LONGEST_NAME} bytes; rename it")
    if any(unicodedata.category(letter) == "Cc" for letter in name):
        raise _refused(archive, text, "has control characters in its name; rename it")
    return place


class _Budget:
    """A counter of an archive's real content, whatever the archive declares."""

    def __init__(self, archive: Path, limits: ArchiveLimits) -> None:
        self.archive, self._limits, self._packed = archive, limits, archive.stat().st_size
        self._members = self._bytes = 0

    def check_declared(self, count: int) -> None:
        """Raise ArchiveError if the archive declares too many members, before their names are read."""
        if count > (most := self._limits.members):
            text = f"{self.archive.name}: {count} files, but at most {most} are allowed; archive fewer files"
            raise ArchiveError("archive_too_many_members", text)

    def count_member(self, name: str) -> None:
        """Count a member. Raises ArchiveError if there are too many."""
        self._members += 1
        if self._members > (most := self._limits.members):
            text = f"exceeds the limit of {most} files; archive fewer files"
            raise _refused(self.archive, name, text, "archive_too_many_members")

    def count_bytes(self, name: str, count: int) -> None:
        """Count unpacked bytes of a member. Raises ArchiveError beyond the limits of size and ratio."""
        self._bytes += count
        if self._bytes > (most := self._limits.unpacked):
            text = f"would exceed the limit of {most} unpacked bytes; use fewer or smaller files"
            raise _refused(self.archive, name, text, "archive_too_large")
        if self._bytes > RATIO_FROM and self._bytes > (ratio := self._limits.ratio) * self._packed:
            text = f"would unpack to over {ratio:g} times the archive's size, which is the limit"
            raise _refused(self.archive, name, text, "archive_ratio")


def _make_folder(archive: Path, name: str, place: Path) -> None:
    try:
        place.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError) as error:
        raise _refused(archive, name, "is both a folder and a file; rename one of them") from error


def _write(budget: _Budget, member: _Member, place: Path) -> None:
    assert member.open is not None, "folders have no content to write"
    archive = budget.archive
    _make_folder(archive, member.name, place.parent)
    try:
        with member.open() as source, open(place, "xb") as sink:
            while chunk := source.read(_CHUNK):
                budget.count_bytes(member.name, len(chunk))
                sink.write(chunk)
    except FileExistsError as error:
        raise _refused(archive, member.name, "is both a folder and a file; rename one of them") from error
    except Exception as error:
        if _is_damage(error):
            raise _refused(archive, member.name, f"cannot be unpacked: {in_short(error)}", "archive_damaged") from error
        raise


def _refused(archive: Path, name: str, what: str, code: str = "archive_unsafe_member") -> ArchiveError:
    return ArchiveError(code, f"{archive.name}: member {name!r} {what}")


def temporary_folder(prefix: str) -> Path:
    """Return a new folder that is removed when this process ends."""
    folder = Path(tempfile.mkdtemp(prefix=prefix))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder
