"""Zipped scenes, honest and hostile."""

from __future__ import annotations

import gzip
import io
import stat
import struct
import tarfile
import warnings
import zipfile

import numpy as np
import pytest
import zstandard

from mgsr.config import DataConfig
from mgsr.data import archive
from mgsr.data.readers import load_scene
from mgsr.errors import SceneError
from tests.data.captures import BallCapture


def zipped(path, folder, top="capture"):
    with zipfile.ZipFile(path, "w") as out:
        for file in sorted(folder.rglob("*")):
            if file.is_file():
                out.write(file, f"{top}/{file.relative_to(folder).as_posix()}")
        out.writestr("__MACOSX/._capture", "junk")
    return path


def test_an_archive_reads_like_its_folder(tmp_path):
    folder = BallCapture().write_plain(tmp_path / "ball")
    scene = load_scene(zipped(tmp_path / "upload.zip", folder), DataConfig())
    same = load_scene(folder, DataConfig())
    assert scene.name == "upload" and scene.root.is_dir()
    assert [view.name for view in scene.train] == [view.name for view in same.train]
    assert (scene.train[0].image == same.train[0].image).all()


def tarred(path, *members: tuple[str, bytes]):
    """A tar whose packing its name tells, of (name, content)."""
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
def test_every_kind_of_archive_has_the_same_files(tmp_path, suffix):
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


def test_content_and_not_the_name_tells_the_kind(tmp_path):
    path = tarred(tmp_path / "a.tar.zst", ("a.txt", b"x"))
    path.rename(tmp_path / "a.zip")
    assert (archive.unpack(tmp_path / "a.zip", tmp_path / "out") / "a.txt").read_bytes() == b"x"


def refuses(path, match):
    """The archive is refused with that message, and nothing is left behind."""
    with pytest.raises(SceneError, match=match):
        archive.unpack(path, path.parent / "out")
    assert not (path.parent / "out").exists()


def test_unpacks_where_it_is_told(tmp_path):
    path = zipped(tmp_path / "a.zip", BallCapture().write_plain(tmp_path / "ball"))
    scene = load_scene(path, DataConfig(), unpack_to=tmp_path / "work")
    assert scene.root == tmp_path / "work" / "capture"


OUTSIDE = ["../evil.txt", "a/../../evil.txt", "/evil.txt", "C:\\evil.txt", "..\\evil.txt"]


@pytest.mark.parametrize("suffix", [".zip", ".tar"])
@pytest.mark.parametrize("name", OUTSIDE)
def test_members_that_point_outside(tmp_path, name, suffix):
    refuses(written(tmp_path, suffix, "fine.txt", name), r"bad\.\w+: member .*evil\.txt' points outside the archive")


@pytest.mark.parametrize("suffix", [".zip", ".tar"])
@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["a/" + "n" * 300], "member 'a/nnn.* has a name longer than 255 bytes; rename it"),
        (["n/" * 2500 + "a"], "member 'n/n/.* has a name longer than"),
        (["a\nb.txt"], "has control characters in its name"),
        (["Photo.png", "photo.PNG"], r"member 'photo\.PNG' has the name of 'Photo\.png', or differs in case only"),
        (["a.png", "a.png"], r"member 'a\.png' has the name of 'a\.png'"),
        (["a", "a/b.png"], "is a folder and a file; rename one"),
        (["a/b.png", "a"], "is a folder and a file; rename one"),
    ],
)
def test_names_that_can_not_be_written(tmp_path, names, message, suffix):
    refuses(written(tmp_path, suffix, *names), message)


def written(folder, suffix, *names):
    path = folder / f"bad{suffix}"
    if suffix == ".tar":
        return tarred(path, *[(name, b"x") for name in names])
    with warnings.catch_warnings(), zipfile.ZipFile(path, "w") as out:
        warnings.simplefilter("ignore")  # that a name comes twice
        for name in names:
            out.writestr(name, "x")
    return path


def test_a_zip_name_that_goes_on_after_its_end(tmp_path):
    path = written(tmp_path, ".zip", "safe.png_x.exe")
    path.write_bytes(path.read_bytes().replace(b"safe.png_x.exe", b"safe.png\0x.exe"))
    refuses(path, "has control characters in its name")


@pytest.mark.parametrize("kind", [tarfile.SYMTYPE, tarfile.LNKTYPE, tarfile.CHRTYPE, tarfile.FIFOTYPE])
def test_links_and_devices_of_tars(tmp_path, kind):
    with tarfile.open(tmp_path / "bad.tar", "w") as out:
        info = tarfile.TarInfo("images")
        info.type, info.linkname = kind, "/etc/passwd"
        out.addfile(tarfile.TarInfo("first.txt"))
        out.addfile(info)
    refuses(tmp_path / "bad.tar", "member 'images' is a link or a special file; put the file in")


def test_an_encrypted_member(tmp_path):
    path = written(tmp_path, ".zip", "a.png")
    data = bytearray(path.read_bytes())
    for signature, place in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        data[data.index(signature) + place] |= 1
    path.write_bytes(data)
    refuses(path, r"member 'a\.png' is encrypted; archive it without a password")


def test_links(tmp_path):
    link = zipfile.ZipInfo("images")
    link.external_attr = (stat.S_IFLNK | 0o777) << 16
    with zipfile.ZipFile(tmp_path / "bad.zip", "w") as out:
        out.writestr(link, "/etc")
    refuses(tmp_path / "bad.zip", "member 'images' is a link")


def test_damaged_member(tmp_path):
    with zipfile.ZipFile(tmp_path / "bad.zip", "w") as out:
        out.writestr("photo.png", b"A" * 1000)
    data = bytearray((tmp_path / "bad.zip").read_bytes())
    data[200] ^= 1
    (tmp_path / "bad.zip").write_bytes(data)
    with pytest.raises(SceneError, match=r"member 'photo\.png' can't be unpacked"):
        archive.unpack(tmp_path / "bad.zip", tmp_path / "out")


@pytest.mark.parametrize("suffix", [".tar.gz", ".tar.zst", ".tar", ".zip"])
def test_archives_that_end_early(tmp_path, suffix):
    content = np.random.default_rng(0).bytes(100_000)
    path = tmp_path / f"bad{suffix}"
    if suffix == ".zip":
        with zipfile.ZipFile(path, "w") as out:
            out.writestr("photo.png", content)
    else:
        tarred(path, ("photo.png", content))
    path.write_bytes(path.read_bytes()[:50_000])
    refuses(path, r"bad\.[\w.]+: (damaged or not an archive|member 'photo\.png' can't be unpacked)")


def test_a_zip_that_points_before_its_beginning(tmp_path):
    path = written(tmp_path, ".zip", "a.png")
    data = bytearray(path.read_bytes())
    end = data.rindex(b"PK\x05\x06") + 16
    data[end : end + 4] = struct.pack("<I", struct.unpack("<I", data[end : end + 4])[0] + 1000)
    path.write_bytes(data)
    refuses(path, r"bad\.zip: (damaged|member 'a\.png' can't be unpacked)")


@pytest.mark.parametrize("head", [b"hello", b"PK\x03\x04 no", b"\x1f\x8b\x08 no", b"\x28\xb5\x2f\xfd no", b""])
def test_what_only_looks_like_an_archive(tmp_path, head):
    (tmp_path / "bad.zip").write_bytes(head + b"x" * 600 * bool(head))
    refuses(tmp_path / "bad.zip", r"bad\.zip: (damaged or not an archive|expected a folder, or an archive)")


def test_an_archive_of_an_archive_is_named(tmp_path):
    inner = tarred(tmp_path / "inner.tar.gz", ("cameras.json", b"{}"))
    outer = tarred(tmp_path / "outer.tar", ("scene/inner.tar.gz", inner.read_bytes()))
    with pytest.raises(SceneError, match=r"another archive, inner\.tar\.gz: unpack that first"):
        load_scene(outer, DataConfig())


def test_a_folder_that_holds_something_is_not_unpacked_to(tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out/mine.txt").write_text("mine")
    with pytest.raises(SceneError, match=r"out: expected an empty folder to unpack a\.tar to"):
        archive.unpack(tarred(tmp_path / "a.tar", ("a", b"x")), tmp_path / "out")
    assert (tmp_path / "out/mine.txt").read_text() == "mine"


# Bombs


@pytest.mark.parametrize("suffix", [".zip", ".tar.gz", ".tar.zst"])
def test_a_bomb(tmp_path, monkeypatch, suffix):
    monkeypatch.setattr(archive, "MAX_BYTES", 1000)
    refuses(zeros(tmp_path, suffix, 5000), "zeros' makes it unpack to more than 1000 bytes, the limit")


@pytest.mark.parametrize("suffix", [".zip", ".tar.gz", ".tar.zst"])
def test_a_bomb_below_the_size_limit_by_its_ratio(tmp_path, monkeypatch, suffix):
    monkeypatch.setattr(archive, "RATIO_FROM", 1 << 20)
    refuses(zeros(tmp_path, suffix, 4 << 20), "zeros' makes it unpack to over 200 times its size, the limit")


def zeros(folder, suffix, count):
    if suffix != ".zip":
        return tarred(folder / f"bad{suffix}", ("zeros", bytes(count)))
    with zipfile.ZipFile(folder / "bad.zip", "w", zipfile.ZIP_DEFLATED) as out:
        out.writestr("zeros", bytes(count))
    return folder / "bad.zip"


def test_sizes_that_lie(tmp_path, monkeypatch):
    """A member that declares ten bytes gives no more of them, whatever follows."""
    monkeypatch.setattr(archive, "MAX_BYTES", 1000)
    path = zeros(tmp_path, ".zip", 5000)
    data = path.read_bytes()
    assert data.count(struct.pack("<I", 5000)) == 2
    path.write_bytes(data.replace(struct.pack("<I", 5000), struct.pack("<I", 10)))
    refuses(path, "member 'zeros' can't be unpacked: Bad CRC")


def test_a_tar_header_that_would_fill_the_memory(tmp_path):
    """A pax header declares its own size, and tarfile reads it whole."""
    info = tarfile.TarInfo("a.txt")
    info.pax_headers = {"comment": "x" * (5 << 20)}
    with tarfile.open(tmp_path / "bad.tar.gz", "w:gz", format=tarfile.PAX_FORMAT) as out:
        out.addfile(info)
    refuses(tmp_path / "bad.tar.gz", "a header of more than 4194304 bytes")


@pytest.mark.parametrize("suffix", [".zip", ".tar"])
def test_too_many_members(tmp_path, monkeypatch, suffix):
    monkeypatch.setattr(archive, "MAX_MEMBERS", 3)
    refuses(written(tmp_path, suffix, *"abcd"), "member 'd' is one too many: at most 3 files are taken")


@pytest.mark.slow
def test_a_hundred_thousand_members_and_one_more(tmp_path):
    path = tarred(tmp_path / "bad.tar.gz", *[(f"{i}.txt", b"") for i in range(archive.MAX_MEMBERS + 1)])
    refuses(path, "member '100000.txt' is one too many: at most 100000 files are taken")
