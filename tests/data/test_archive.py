"""Zipped scenes, honest and hostile."""

from __future__ import annotations

import stat
import zipfile

import pytest

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


def test_unpacks_where_it_is_told(tmp_path):
    path = zipped(tmp_path / "a.zip", BallCapture().write_plain(tmp_path / "ball"))
    scene = load_scene(path, DataConfig(), unpack_to=tmp_path / "work")
    assert scene.root == tmp_path / "work" / "capture"


@pytest.mark.parametrize("name", ["../evil.txt", "a/../../evil.txt", "/evil.txt", "C:\\evil.txt", "..\\evil.txt"])
def test_members_that_point_outside(tmp_path, name):
    with zipfile.ZipFile(tmp_path / "bad.zip", "w") as out:
        out.writestr("fine.txt", "x")
        out.writestr(name, "x")
    with pytest.raises(SceneError, match=r"bad\.zip: member .*evil\.txt' points outside"):
        archive.unpack(tmp_path / "bad.zip", tmp_path / "out")
    assert not (tmp_path / "out").exists(), "nothing is written before all members are checked"


def test_links(tmp_path):
    link = zipfile.ZipInfo("images")
    link.external_attr = (stat.S_IFLNK | 0o777) << 16
    with zipfile.ZipFile(tmp_path / "bad.zip", "w") as out:
        out.writestr(link, "/etc")
    with pytest.raises(SceneError, match="member 'images' is a link"):
        archive.unpack(tmp_path / "bad.zip", tmp_path / "out")


def test_damaged_member(tmp_path):
    with zipfile.ZipFile(tmp_path / "bad.zip", "w") as out:
        out.writestr("photo.png", b"A" * 1000)
    data = bytearray((tmp_path / "bad.zip").read_bytes())
    data[200] ^= 1
    (tmp_path / "bad.zip").write_bytes(data)
    with pytest.raises(SceneError, match=r"member 'photo\.png' can't be unpacked"):
        archive.unpack(tmp_path / "bad.zip", tmp_path / "out")


def test_not_a_zip(tmp_path):
    (tmp_path / "bad.zip").write_text("hello")
    with pytest.raises(SceneError, match=r"bad\.zip: not a zip archive"):
        load_scene(tmp_path / "bad.zip", DataConfig())


def test_a_bomb(tmp_path, monkeypatch):
    monkeypatch.setattr(archive, "MAX_BYTES", 1000)
    with zipfile.ZipFile(tmp_path / "bad.zip", "w", zipfile.ZIP_DEFLATED) as out:
        out.writestr("zeros", b"\0" * 5000)
    with pytest.raises(SceneError, match="at most"):
        archive.unpack(tmp_path / "bad.zip", tmp_path / "out")
