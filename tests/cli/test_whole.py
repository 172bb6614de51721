"""Results appear whole or not at all."""

from __future__ import annotations

from pathlib import Path

import pytest

from mgsr.cli.whole import whole


def test_a_file_replaces_the_old_one_only_when_it_is_done(tmp_path: Path) -> None:
    target = tmp_path / "deep" / "mesh.ply"
    with whole(target) as path:
        assert path.suffix == ".ply" and path.parent == target.parent
        path.write_text("first")
    with pytest.raises(RuntimeError), whole(target) as path:
        path.write_text("half")
        raise RuntimeError("power cut")
    assert target.read_text() == "first"
    assert [entry.name for entry in target.parent.iterdir()] == ["mesh.ply"]


def test_a_folder_replaces_the_old_one_with_all_that_was_in_it(tmp_path: Path) -> None:
    target = tmp_path / "test"
    target.mkdir()
    (target / "stale.png").touch()
    with whole(target) as path:
        path.mkdir()
        (path / "new.png").touch()
    assert [entry.name for entry in target.iterdir()] == ["new.png"]
    assert [entry.name for entry in tmp_path.iterdir()] == ["test"]
