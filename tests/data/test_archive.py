"""Zipped scenes, honest and hostile."""

from __future__ import annotations

import bz2
import errno
import gzip
import io
import lzma
import os
import shutil
import stat
import struct
import subprocess
import sys
import tarfile
import tempfile
import warnings
import zipfile
from pathlib import Path

import numpy as np
import pytest
import zstandard

from mgsr.config import DataConfig
from mgsr.data import archive
from mgsr.data.archive import ArchiveLimits
from mgsr.data.readers import load_scene
from mgsr.errors import ArchiveError, SceneError
from tests.data.captures import BallCapture


def zipped(path: Path, folder: Path, top: str = "capture") -> Path:
    with zipfile.ZipFile(path, "w") as out:
        for file in sorted(folder.rglob("*")):
            if file.is_file():
                out.write(file, f"{top}/{file.relative_to(folder).as_posix()}")
        out.writestr("__MACOSX/._capture", "junk")
    return path


def test_an_archive_reads_like_its_folder(tmp_path: Path) -> None:
    folder = BallCapture().write_plain(tmp_path / "ball")
    scene = load_scene(zipped(tmp_path / "upload.zip", folder), DataConfig())
    same = load_scene(folder, DataConfig())
    assert scene.name == "upload" and scene.root.is_dir()
    assert [view.name for view in scene.train] == [view.name for view in same.train]
    assert (scene.train[0].image == same.train[0].image).all()


def tarred(path: Path, *members: tuple[str, bytes]) -> Path:
    """Write a tar of (name, content), packed as its file name says."""
    plain = io.BytesIO()
    with tarfile.open(fileobj=plain, mode="w") as out:
        for name, content in members:
            info = tarfile.TarInfo(name)
            info.size = len(content)
            out.addfile(info, io.BytesIO(content))
    pack = gzip.compress if path.name.endswith("gz") else zstandard.compress if path.name.endswith("zst") else bytes
    path.write_bytes(pack(plain.getvalue()))
    return path


@pytest.mark.parametrize("suffix", [".zip", ".tar", ".tar.gz", ".tgz", ".tar.zst", ".tzst"])
def test_every_kind_of_archive_has_the_same_files(tmp_path: Path, suffix: str) -> None:
    members = [("capture/a.txt", b"a" * 1000), ("capture/sub/b.bin", bytes(range(256))), ("__MACOSX/._a", b"junk")]
    path = tmp_path / f"up.load{suffix}"
    if suffix == ".zip":
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as out:
            for name, content in members:
                out.writestr(name, content)
    else:
        tarred(path, *members)
    folder = archive.unpack(path, tmp_path / "out")
    files = {str(file.relative_to(folder)): file.read_bytes() for file in folder.rglob("*") if file.is_file()}
    assert files == dict(members[:2]) and archive.archive_stem(path) == "up.load"


def test_content_and_not_the_name_tells_the_kind(tmp_path: Path) -> None:
    path = tarred(tmp_path / "a.tar.zst", ("a.txt", b"x"))
    path.rename(tmp_path / "a.zip")
    assert (archive.unpack(tmp_path / "a.zip", tmp_path / "out") / "a.txt").read_bytes() == b"x"


def refuses(
    path: Path, match: str, code: str = "archive_unsafe_member", limits: archive.ArchiveLimits | None = None
) -> None:
    """Check that the archive is refused with that message and code, and that nothing is left behind."""
    with pytest.raises(ArchiveError, match=match) as refused:
        archive.unpack(path, path.parent / "out", limits)
    assert refused.value.code == code
    assert not (path.parent / "out").exists()


def test_unpacks_where_it_is_told(tmp_path: Path) -> None:
    path = zipped(tmp_path / "a.zip", BallCapture().write_plain(tmp_path / "ball"))
    scene = load_scene(path, DataConfig(), unpack_to=tmp_path / "work")
    assert scene.root == tmp_path / "work" / "capture"


OUTSIDE = ["../evil.txt", "a/../../evil.txt", "/evil.txt", "C:\\evil.txt", "..\\evil.txt"]


@pytest.mark.parametrize("suffix", [".zip", ".tar"])
@pytest.mark.parametrize("name", OUTSIDE)
def test_members_that_point_outside(tmp_path: Path, name: str, suffix: str) -> None:
    refuses(written(tmp_path, suffix, "fine.txt", name), r"bad\.\w+: member .*evil\.txt' points outside the archive")


@pytest.mark.parametrize("suffix", [".zip", ".tar"])
@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["a/" + "n" * 300], "member 'a/nnn.* has a name longer than 255 bytes; rename it"),
        (["n/" * 2500 + "a"], "member 'n/n/.* has a name longer than"),
        (["a\nb.txt"], "has control characters in its name"),
        (["a\x9b2Jb.txt"], "has control characters in its name"),
        (["Photo.png", "photo.PNG"], r"member 'photo\.PNG' has the same name as 'Photo\.png', except perhaps for case"),
        (["a.png", "a.png"], r"member 'a\.png' has the same name as 'a\.png'"),
        (["a", "a/b.png"], "is both a folder and a file; rename one"),
        (["a/b.png", "a"], "is both a folder and a file; rename one"),
    ],
)
def test_names_that_can_not_be_written(tmp_path: Path, names: list[str], message: str, suffix: str) -> None:
    refuses(written(tmp_path, suffix, *names), message)


def written(folder: Path, suffix: str, *names: str) -> Path:
    path = folder / f"bad{suffix}"
    if suffix == ".tar":
        return tarred(path, *[(name, b"x") for name in names])
    with warnings.catch_warnings(), zipfile.ZipFile(path, "w") as out:
        warnings.simplefilter("ignore")  # that a name comes twice
        for name in names:
            out.writestr(name, "x")
    return path


def test_a_zip_name_that_goes_on_after_its_end(tmp_path: Path) -> None:
    path = written(tmp_path, ".zip", "safe.png_x.exe")
    path.write_bytes(path.read_bytes().replace(b"safe.png_x.exe", b"safe.png\0x.exe"))
    refuses(path, "has control characters in its name")


@pytest.mark.parametrize("kind", [tarfile.SYMTYPE, tarfile.LNKTYPE, tarfile.CHRTYPE, tarfile.FIFOTYPE])
def test_links_and_devices_of_tars(tmp_path: Path, kind: bytes) -> None:
    with tarfile.open(tmp_path / "bad.tar", "w") as out:
        info = tarfile.TarInfo("images")
        info.type, info.linkname = kind, "/etc/passwd"
        out.addfile(tarfile.TarInfo("first.txt"))
        out.addfile(info)
    refuses(tmp_path / "bad.tar", "member 'images' is a link or a special file; archive the file itself")


def test_an_encrypted_member(tmp_path: Path) -> None:
    path = written(tmp_path, ".zip", "a.png")
    data = bytearray(path.read_bytes())
    for signature, place in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        data[data.index(signature) + place] |= 1
    path.write_bytes(data)
    refuses(path, r"member 'a\.png' is encrypted; archive it without a password")


def test_links(tmp_path: Path) -> None:
    link = zipfile.ZipInfo("images")
    link.external_attr = (stat.S_IFLNK | 0o777) << 16
    with zipfile.ZipFile(tmp_path / "bad.zip", "w") as out:
        out.writestr(link, "/etc")
    refuses(tmp_path / "bad.zip", "member 'images' is a link")


def test_damaged_member(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "bad.zip", "w") as out:
        out.writestr("photo.png", b"A" * 1000)
    data = bytearray((tmp_path / "bad.zip").read_bytes())
    data[200] ^= 1
    (tmp_path / "bad.zip").write_bytes(data)
    refuses(tmp_path / "bad.zip", r"member 'photo\.png' cannot be unpacked", "archive_damaged")


@pytest.mark.parametrize("suffix", [".tar.gz", ".tar.zst", ".tar", ".zip"])
def test_archives_that_end_early(tmp_path: Path, suffix: str) -> None:
    content = np.random.default_rng(0).bytes(100_000)
    path = tmp_path / f"bad{suffix}"
    if suffix == ".zip":
        with zipfile.ZipFile(path, "w") as out:
            out.writestr("photo.png", content)
    else:
        tarred(path, ("photo.png", content))
    path.write_bytes(path.read_bytes()[:50_000])
    message = r"bad\.[\w.]+: (the file is damaged or not an archive|member 'photo\.png' cannot be unpacked)"
    refuses(path, message, "archive_damaged")


def test_a_packing_that_nobody_knows(tmp_path: Path) -> None:
    path = written(tmp_path, ".zip", "a.png")
    data = bytearray(path.read_bytes())
    data[8] = data[data.rindex(b"PK\x01\x02") + 10] = 97
    path.write_bytes(data)
    refuses(
        path, r"member 'a\.png' uses compression method 97 \(unknown\), which MGSR does not read", "archive_unsupported"
    )


@pytest.mark.parametrize(("method", "name"), [(9, "Deflate64"), (93, "Zstandard")])
def test_a_packing_that_is_not_read(tmp_path: Path, method: int, name: str) -> None:
    path = written(tmp_path, ".zip", "a.png")
    data = bytearray(path.read_bytes())
    data[8] = data[data.rindex(b"PK\x01\x02") + 10] = method
    path.write_bytes(data)
    refuses(
        path, rf"'a\.png' uses compression method {method} \({name}\).*; use Deflate, or create", "archive_unsupported"
    )


def test_an_archive_of_nothing_is_an_empty_folder(tmp_path: Path) -> None:
    assert list(archive.unpack(written(tmp_path, ".zip"), tmp_path / "out").iterdir()) == []


def test_a_zip_that_points_before_its_beginning(tmp_path: Path) -> None:
    path = written(tmp_path, ".zip", "a.png")
    data = bytearray(path.read_bytes())
    end = data.rindex(b"PK\x05\x06") + 16
    data[end : end + 4] = struct.pack("<I", struct.unpack("<I", data[end : end + 4])[0] + 1000)
    path.write_bytes(data)
    refuses(path, r"bad\.zip: (the file is damaged|member 'a\.png' cannot be unpacked)", "archive_damaged")


@pytest.mark.parametrize("head", [b"PK\x03\x04 no", b"\x1f\x8b\x08 no", b"\x28\xb5\x2f\xfd no"])
def test_what_only_begins_like_an_archive(tmp_path: Path, head: bytes) -> None:
    (tmp_path / "bad.zip").write_bytes(head + b"x" * 600)
    refuses(tmp_path / "bad.zip", r"bad\.zip: the file is damaged or not an archive", "archive_damaged")


@pytest.mark.parametrize("data", [b"", b"hello", b"Rar!\x1a\x07\x01\x00" + bytes(600)])
def test_what_is_no_archive(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "bad.zip").write_bytes(data)
    refuses(tmp_path / "bad.zip", r"bad\.zip: expected a folder or an archive", "archive_unsupported")


@pytest.mark.parametrize(
    ("head", "name"),
    [
        (bz2.compress(b"x" * 600), "bzip2"),
        (lzma.compress(b"x" * 600), "xz"),
        (b"7z\xbc\xaf\x27\x1c" + bytes(600), "7z"),
        (b"Rar!\x1a\x07\x01\x00" + bytes(600), "RAR"),
    ],
)
def test_other_archives_are_named(tmp_path: Path, head: bytes, name: str) -> None:
    (tmp_path / "bad.zip").write_bytes(head)
    message = rf"expected .*\.tar\.zst\), got {name}; unpack it and archive its folder as \.zip or \.tar\.gz"
    refuses(tmp_path / "bad.zip", message, "archive_unsupported")


def test_a_tar_of_unix_v7(tmp_path: Path) -> None:
    """Check that a Unix V7 tar is read: it is a ustar without the header's last 255 bytes."""
    path = tarred(tmp_path / "a.tar", ("a.txt", b"x" * 600))
    data = bytearray(path.read_bytes())
    data[257:512] = bytes(255)
    data[148:156] = b" " * 8
    data[148:156] = b"%06o\0 " % sum(data[:512])
    path.write_bytes(data)
    assert subprocess.check_output(["tar", "-tf", path], text=True) == "a.txt\n"
    assert (archive.unpack(path, tmp_path / "out") / "a.txt").read_bytes() == b"x" * 600


@pytest.mark.parametrize("suffix", [".zip", ".tar"])
def test_what_macos_puts_beside_files_is_left_out(tmp_path: Path, suffix: str) -> None:
    names = ("._scene", "scene/a.png", "scene/._a.png", "__MACOSX/scene/._a.png", "scene/.DS_Store")
    folder = archive.unpack(written(tmp_path, suffix, *names), tmp_path / "out")
    assert [file.relative_to(folder).as_posix() for file in folder.rglob("*") if file.is_file()] == ["scene/a.png"]


def test_hard_links_of_a_tar_name_the_cure(tmp_path: Path) -> None:
    """Check that hard links are refused with the cure; GNU tar makes them of files that have two names."""
    (tmp_path / "s").mkdir()
    (tmp_path / "s/a.png").write_bytes(b"x")
    os.link(tmp_path / "s/a.png", tmp_path / "s/b.png")
    subprocess.run(["tar", "-C", tmp_path, "-cf", tmp_path / "bad.tar", "s"], check=True)
    refuses(tmp_path / "bad.tar", "link or a special file; archive the file itself .*--hard-dereference")
    subprocess.run(["tar", "-C", tmp_path, "--hard-dereference", "-cf", tmp_path / "good.tar", "s"], check=True)
    assert len(list((archive.unpack(tmp_path / "good.tar", tmp_path / "out") / "s").iterdir())) == 2


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EFBIG, errno.EDQUOT])
def test_a_full_disk_names_the_folder_and_the_cure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    def full(place: object, mode: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(archive, "open", full, raising=False)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with pytest.raises(OSError, match=rf"a\.zip unpacks to {tmp_path}/mgsr-scene-\w+/a; free some .* TMPDIR") as raised:
        archive.unpack(written(tmp_path, ".zip", "a.png").rename(tmp_path / "a.zip"))
    assert raised.value.errno == number and not list(tmp_path.glob("mgsr-scene-*"))


def test_an_archive_of_an_archive_is_named(tmp_path: Path) -> None:
    inner = tarred(tmp_path / "inner.tar.gz", ("cameras.json", b"{}"))
    outer = tarred(tmp_path / "outer.tar", ("scene/inner.tar.gz", inner.read_bytes()))
    with pytest.raises(SceneError, match=r"another archive, inner\.tar\.gz; unpack that first"):
        load_scene(outer, DataConfig())


def test_a_folder_that_holds_something_is_not_unpacked_to(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out/mine.txt").write_text("mine")
    with pytest.raises(SceneError, match=r"out: expected an empty folder to unpack a\.tar into"):
        archive.unpack(tarred(tmp_path / "a.tar", ("a", b"x")), tmp_path / "out")
    assert (tmp_path / "out/mine.txt").read_text() == "mine"


# Bombs


@pytest.mark.parametrize("suffix", [".zip", ".tar.gz", ".tar.zst"])
def test_a_bomb(tmp_path: Path, suffix: str) -> None:
    path = zeros(tmp_path, suffix, 5000)
    message = "zeros' would exceed the limit of 1000 unpacked bytes; use fewer or smaller files"
    refuses(path, message, "archive_too_large", ArchiveLimits(unpacked=1000))


def test_no_more_than_the_limit_is_ever_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Check that the first member stays under the limit, and that no byte of the second reaches the disk beyond it."""
    monkeypatch.setattr(shutil, "rmtree", lambda folder, **how: None)  # what is left to look at
    path = tarred(tmp_path / "bad.tar.gz", ("a", bytes(1 << 19)), ("b", bytes(5 << 20)))
    with pytest.raises(ArchiveError, match="'b' would exceed the limit of 1048576 unpacked bytes"):
        archive.unpack(path, tmp_path / "out", ArchiveLimits(unpacked=1 << 20))
    assert sum(file.stat().st_size for file in (tmp_path / "out").iterdir()) <= 1 << 20


@pytest.mark.parametrize("suffix", [".zip", ".tar.gz", ".tar.zst"])
def test_a_bomb_below_the_size_limit_by_its_ratio(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str) -> None:
    monkeypatch.setattr(archive, "RATIO_FROM", 1 << 20)
    path = zeros(tmp_path, suffix, 4 << 20)
    refuses(path, "zeros' would unpack to over 200 times the archive's size, which is the limit", "archive_ratio")


def zeros(folder: Path, suffix: str, count: int) -> Path:
    if suffix != ".zip":
        return tarred(folder / f"bad{suffix}", ("zeros", bytes(count)))
    with zipfile.ZipFile(folder / "bad.zip", "w", zipfile.ZIP_DEFLATED) as out:
        out.writestr("zeros", bytes(count))
    return folder / "bad.zip"


def test_sizes_that_lie(tmp_path: Path) -> None:
    """Check that a member that declares ten bytes gives no more of them, whatever follows."""
    path = zeros(tmp_path, ".zip", 5000)
    data = path.read_bytes()
    assert data.count(struct.pack("<I", 5000)) == 2
    path.write_bytes(data.replace(struct.pack("<I", 5000), struct.pack("<I", 10)))
    refuses(path, "member 'zeros' cannot be unpacked: Bad CRC", "archive_damaged")


def test_a_tar_header_that_would_fill_the_memory(tmp_path: Path) -> None:
    """Check that a long pax header is refused: it declares its own size, and tarfile reads it whole."""
    info = tarfile.TarInfo("a.txt")
    info.pax_headers = {"comment": "x" * (5 << 20)}
    with tarfile.open(tmp_path / "bad.tar.gz", "w:gz", format=tarfile.PAX_FORMAT) as out:
        out.addfile(info)
    refuses(tmp_path / "bad.tar.gz", "a header exceeds 4194304 bytes", "archive_damaged")


def test_a_sparse_tar(tmp_path: Path) -> None:
    """Check that five gigabytes of holes in half a kilobyte are refused."""
    with (tmp_path / "holes").open("wb") as file:
        file.truncate(5 << 30)
    subprocess.run(["tar", "-C", tmp_path, "--sparse", "-cf", tmp_path / "bad.tar", "holes"], check=True)
    assert (tmp_path / "bad.tar").stat().st_size < 100_000
    refuses(tmp_path / "bad.tar", "member 'holes' is a link or a special file")


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".tar.gz", ".tar.zst"])
def test_memory_stays_bounded(tmp_path: Path, suffix: str) -> None:
    """Check that memory stays bounded where hundreds of megabytes unpack from a few, and exceed the limit."""
    path = zeros(tmp_path, suffix, 300 << 20)
    code = (
        "import sys, resource; from pathlib import Path; from mgsr.data.archive import *\n"
        "before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss\n"
        "path, limits = Path(sys.argv[1]), ArchiveLimits(unpacked=200 << 20, ratio=1e9)\n"
        "try: unpack(path, path.with_name('out'), limits)\n"
        "except SceneError as error: assert error.code == 'archive_too_large', error\n"
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)"
    )
    ran = subprocess.run([sys.executable, "-c", code, str(path)], capture_output=True, text=True, timeout=120)
    assert ran.returncode == 0, ran.stderr
    assert int(ran.stdout) * 1024 < 30 << 20


TOO_MANY = "member 'd' exceeds the limit of 3 files; archive fewer files"


@pytest.mark.parametrize(
    ("suffix", "message"), [(".zip", "4 files, but at most 3 are allowed; archive fewer files"), (".tar", TOO_MANY)]
)
def test_too_many_members(tmp_path: Path, suffix: str, message: str) -> None:
    path = written(tmp_path, suffix, *"abcd")
    refuses(path, message, "archive_too_many_members", ArchiveLimits(members=3))


def test_too_many_members_in_a_zip_that_says_it_has_fewer(tmp_path: Path) -> None:
    path = written(tmp_path, ".zip", *"abcd")
    data = bytearray(path.read_bytes())
    end = data.rindex(b"PK\5\6")
    data[end + 8 : end + 12] = struct.pack("<HH", 1, 1)
    path.write_bytes(data)
    refuses(path, TOO_MANY, "archive_too_many_members", ArchiveLimits(members=3))


def test_a_zip_with_more_members_than_16_bits_count(tmp_path: Path) -> None:
    """Check that such a zip is refused before its names are read, so that they need not be there."""
    record = struct.pack("<4sQHHIIQQQQ", b"PK\6\6", 44, 45, 45, 0, 0, *[300_000] * 2, 0, 0)
    locator = struct.pack("<4sIQI", b"PK\6\7", 0, 4, 1)
    end = struct.pack("<4sHHHHIIH", b"PK\5\6", 0, 0, 0xFFFF, 0xFFFF, 0xFFFFFFFF, 0xFFFFFFFF, 7)
    (tmp_path / "bad.zip").write_bytes(b"PK\3\4" + record + locator + end + b"comment")
    refuses(tmp_path / "bad.zip", "300000 files, but at most 100000 are allowed", "archive_too_many_members")


@pytest.mark.slow
def test_seventy_thousand_members(tmp_path: Path) -> None:
    path = written(tmp_path, ".zip", *map(str, range(70_000)))
    refuses(
        path, "70000 files, but at most 69999 are allowed", "archive_too_many_members", ArchiveLimits(members=69_999)
    )


@pytest.mark.slow
def test_a_hundred_thousand_members_and_one_more(tmp_path: Path) -> None:
    path = tarred(tmp_path / "bad.tar.gz", *[(f"{i}.txt", b"") for i in range(100_001)])
    refuses(
        path, "member '100000.txt' exceeds the limit of 100000 files; archive fewer files", "archive_too_many_members"
    )
