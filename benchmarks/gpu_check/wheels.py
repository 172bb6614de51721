"""Python packages that a bare machine may lack, carried to it as wheels without the parts that are not run."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

# What the machines for which wheels are fetched run.
PYTHON = "3.12"
PLATFORMS = ("manylinux_2_28_x86_64", "manylinux_2_27_x86_64", "manylinux_2_24_x86_64", "manylinux2014_x86_64")


@dataclass(frozen=True)
class Wanted:
    """A package: what pip is asked for, and the parts of its wheel that are left out."""

    requirement: str
    without: tuple[str, ...] = ()


# GLM comes with its documentation, which is nine tenths of gsplat's wheel; cuda-core with a half for each CUDA.
_GLM = "gsplat/cuda/csrc/third_party/glm"
WANTED = (
    Wanted("plyfile>=1.1"),
    Wanted("gsplat==1.5.3", (f"{_GLM}/doc/", f"{_GLM}/test/", f"{_GLM}/util/")),
    Wanted("cuda-core>=1.2,<2", ("cuda/core/cu12/",)),
)


def fetch_wheels(folder: Path, wanted: Sequence[Wanted] = WANTED) -> list[Path]:
    """Download the wheels into a folder, by pip, and slim them; a package that is there stays.

    Raises CalledProcessError where pip finds none.
    """
    return [find_wheel([folder], _name(each)) or _fetch(folder, each) for each in wanted]


def find_wheel(places: Sequence[Path], name: str) -> Path | None:
    """Return the wheel of a package among files and in folders, None where there is none."""
    files = [file for place in places for file in (sorted(place.iterdir()) if place.is_dir() else [place])]
    stem = name.replace("-", "_")
    return next((file for file in files if file.suffix == ".whl" and file.name.split("-")[0] == stem), None)


def unpack_wheel(wheel: Path, folder: Path) -> None:
    """Put a wheel's content into a folder from which Python can import it; pip is not needed."""
    with zipfile.ZipFile(wheel) as stored:
        stored.extractall(folder)


def slim(wheel: Path, target: Path, without: Sequence[str]) -> None:
    """Write a wheel without what lies under the paths `without`."""
    with zipfile.ZipFile(wheel) as full, zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as kept:
        for name in _kept(full.namelist(), without):
            content = full.read(name)
            if name.endswith(".dist-info/RECORD"):
                lines = content.decode().splitlines()
                content = "".join(f"{line}\n" for line in _kept(lines, without)).encode()
            kept.writestr(full.getinfo(name), content, zipfile.ZIP_DEFLATED)


def _kept(names: Sequence[str], without: Sequence[str]) -> Iterator[str]:
    return (name for name in names if not name.startswith(tuple(without)))


def _fetch(folder: Path, wanted: Wanted) -> Path:
    """Download a wheel for the other machine and keep what is needed of it."""
    platforms = [word for platform in PLATFORMS for word in ("--platform", platform)]
    with tempfile.TemporaryDirectory() as made:
        command = [sys.executable, "-m", "pip", "download", "-q", "--no-deps", "--only-binary=:all:", "-d", made]
        command += ["--python-version", PYTHON, "--implementation", "cp", *platforms, wanted.requirement]
        subprocess.run(command, check=True)
        (full,) = Path(made).glob("*.whl")
        unfinished = folder / f".{full.name}"
        slim(full, unfinished, wanted.without)
        os.replace(unfinished, folder / full.name)
    return folder / full.name


def _name(wanted: Wanted) -> str:
    return wanted.requirement.partition("=")[0].rstrip("<>")
