"""Results appear whole or not at all."""

from __future__ import annotations

from pathlib import Path

import pytest

from mgsr.errors import ConfigError
from mgsr.pipeline.atomic_write import atomic_write


def test_a_file_replaces_the_old_one_only_when_it_is_done(tmp_path: Path) -> None:
    target = tmp_path / "deep" / "mesh.ply"
    with atomic_write(target) as path:
        assert path.suffix == ".ply" and path.parent == target.parent
        path.write_text("first")
    with pytest.raises(RuntimeError), atomic_write(target) as path:
        path.write_text("half")
        raise RuntimeError("power cut")
    assert target.read_text() == "first"
    assert [entry.name for entry in target.parent.iterdir()] == ["mesh.ply"]


def test_a_folder_replaces_the_old_one_with_all_that_was_in_it(tmp_path: Path) -> None:
    target = tmp_path / "test"
    target.mkdir()
    (target / "stale.png").touch()
    with atomic_write(target) as path:
        path.mkdir()
        (path / "new.png").touch()
    assert [entry.name for entry in target.iterdir()] == ["new.png"]
    assert [entry.name for entry in tmp_path.iterdir()] == ["test"]


def test_files_and_folders_do_not_replace_each_other(tmp_path: Path) -> None:
    (tmp_path / "photos.ply").mkdir()
    (tmp_path / "photos.ply" / "a.jpg").write_text("kept")
    (tmp_path / "scene").write_text("kept")
    found_a_folder, found_a_file = r"photos\.ply: .* found a folder", r"scene: expected a folder to write, found a file"
    with pytest.raises(ConfigError, match=found_a_folder), atomic_write(tmp_path / "photos.ply") as path:
        path.write_text("mesh")
    with pytest.raises(ConfigError, match=found_a_file), atomic_write(tmp_path / "scene") as path:
        path.mkdir()
    assert (tmp_path / "photos.ply" / "a.jpg").read_text() == (tmp_path / "scene").read_text() == "kept"
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["photos.ply", "scene"]


def test_a_link_is_written_through(tmp_path: Path) -> None:
    (tmp_path / "deep").mkdir()
    (tmp_path / "deep" / "mesh.ply").write_text("first")
    (tmp_path / "link.ply").symlink_to(tmp_path / "deep" / "mesh.ply")
    with atomic_write(tmp_path / "link.ply") as path:
        path.write_text("second")
    assert (tmp_path / "link.ply").is_symlink() and (tmp_path / "deep" / "mesh.ply").read_text() == "second"


def test_devices_are_not_replaced() -> None:
    with pytest.raises(ConfigError, match="/dev/null: this is neither a file nor"), atomic_write(Path("/dev/null")):
        pass
