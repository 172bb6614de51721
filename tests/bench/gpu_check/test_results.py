"""The files of the results: added to, never over their size, splats.zip whole at every moment."""

from __future__ import annotations

import random
import zipfile
from pathlib import Path

from benchmarks.gpu_check.results import FILES, LARGEST, Results


def test_files_are_added_to(tmp_path: Path) -> None:
    for part in (1, 2):
        results = Results(tmp_path / "results")
        results.add("log.txt", f"part {part}\n")
        results.row(step="benchmark", part=part)
        results.row(step="memory")
    assert (tmp_path / "results" / "log.txt").read_text() == "part 1\npart 2\n"
    assert [row["part"] for row in results.rows("benchmark")] == [1, 2]
    assert Results(tmp_path / "other").rows("benchmark") == []


def test_a_file_that_is_full_takes_no_more(tmp_path: Path) -> None:
    results = Results(tmp_path, largest=1000)
    for _ in range(20):
        results.add("log.txt", "x" * 300 + "\n")
    text = (tmp_path / "log.txt").read_text()
    assert len(text) == 1000 and text.startswith("x" * 300) and "the file is full" in text
    results.add("tests.txt", "another file takes what it is given")
    assert (tmp_path / "tests.txt").read_text() == "another file takes what it is given"


def test_limits_of_a_machine_that_is_lent() -> None:
    """Check that the results stay within eight files of 16 MiB.

    splats.zip is two of them while it is being written.
    """
    assert len(FILES) + 1 <= 8 and LARGEST <= 16 * 2**20


def files_of(folder: Path, content: bytes) -> list[Path]:
    folder.mkdir(parents=True)
    (folder / "splats_2d.ply").write_bytes(content)
    (folder / "training.json").write_text("{}")
    return sorted(folder.iterdir())


def test_splats_of_each_scene_are_kept_once(tmp_path: Path) -> None:
    results = Results(tmp_path / "results")
    assert results.keep_splats("spot", files_of(tmp_path / "a", b"old" * 100)) > 0
    assert results.keep_splats("bunny", files_of(tmp_path / "b", b"bunny" * 100)) > 0
    assert results.keep_splats("spot", files_of(tmp_path / "c", b"new" * 100)) > 0
    with zipfile.ZipFile(results.folder / "splats.zip") as archive:
        assert archive.testzip() is None
        names = sorted(archive.namelist())
        assert names == [
            f"{scene}/{file}" for scene in ("bunny", "spot") for file in ("splats_2d.ply", "training.json")
        ]
        assert archive.read("spot/splats_2d.ply") == b"new" * 100
        assert archive.read("bunny/splats_2d.ply") == b"bunny" * 100
    assert [file.name for file in results.folder.iterdir()] == ["splats.zip"]


def test_splats_that_are_too_many_leave_what_there_is(tmp_path: Path) -> None:
    results = Results(tmp_path / "results", largest=3000)
    assert results.keep_splats("spot", files_of(tmp_path / "a", b"small")) > 0
    before = (results.folder / "splats.zip").read_bytes()
    assert results.keep_splats("lego", files_of(tmp_path / "b", random.Random(0).randbytes(5000))) == 0
    assert (results.folder / "splats.zip").read_bytes() == before
    assert [file.name for file in results.folder.iterdir()] == ["splats.zip"]
