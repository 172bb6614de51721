"""Wheels without what is not run, from which Python imports as from whole ones."""

from __future__ import annotations

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from benchmarks.gpu_check import __main__ as check
from benchmarks.gpu_check.results import Results
from benchmarks.gpu_check.runner import Place
from benchmarks.gpu_check.wheels import WANTED, fetch_wheels, find_wheel, slim, unpack_wheel

RECORD = "made-1.0.dist-info/RECORD"


@pytest.fixture
def wheel(tmp_path: Path) -> Path:
    file = tmp_path / "made-1.0-py3-none-any.whl"
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("made/__init__.py", "ANSWER = 42\n")
        archive.writestr("made/doc/page.html", "x" * 100_000)
        archive.writestr(RECORD, "made/__init__.py,,\nmade/doc/page.html,,\n" + RECORD + ",,\n")
    return file


def test_a_slim_wheel_has_what_is_run(wheel: Path, tmp_path: Path) -> None:
    small = tmp_path / "small" / wheel.name
    small.parent.mkdir()
    slim(wheel, small, ("made/doc/",))
    with zipfile.ZipFile(small) as archive:
        assert archive.namelist() == ["made/__init__.py", RECORD]
        assert archive.read(RECORD).decode() == f"made/__init__.py,,\n{RECORD},,\n"
    unpack_wheel(small, tmp_path / "site")
    program = "import made; print(made.ANSWER)"
    done = subprocess.run([sys.executable, "-c", program], env={"PYTHONPATH": str(tmp_path / "site")}, stdout=-1)
    assert done.stdout == b"42\n"


def test_wheels_are_found_among_files_and_folders(wheel: Path) -> None:
    assert find_wheel([wheel], "made") == find_wheel([wheel.parent], "made") == wheel
    assert find_wheel([wheel.parent], "mad") is None and find_wheel([], "made") is None


def test_wheels_that_are_there_are_not_fetched(tmp_path: Path) -> None:
    names = ("plyfile-1.1-py3-none-any.whl", "gsplat-1.5.3-py3-none-any.whl", "cuda_core-1.2.0-cp312-cp312-any.whl")
    for name in names:
        (tmp_path / name).touch()
    assert [path.name for path in fetch_wheels(tmp_path)] == list(names) and len(WANTED) == len(names)


def test_only_what_the_interpreter_lacks_is_unpacked(
    wheel: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(check, "NEEDED", {"made": "import made_of_nothing", "plyfile": "import plyfile"})
    (tmp_path / "plyfile-1.1-py3-none-any.whl").touch()
    place = Place(Results(tmp_path / "results"), tmp_path / "work", sys.executable, "cpu", (tmp_path,))
    check.bring_packages(place)
    assert [path.name for path in (tmp_path / "work").iterdir()] == ["site-made"]
    assert (tmp_path / "results" / "summary.md").read_text() == f"- made is taken from {wheel.name}\n"
