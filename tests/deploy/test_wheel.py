"""The wheel as pip builds it: what lies in it, and that it works where there is no checkout."""

from __future__ import annotations

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FAMILIES = (
    *("adam", "environment_map", "fusion", "gaussians", "harmonics", "image", "lights", "mirrored", "stereo"),
    *("surfels", "terms"),
)


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the wheel from what git tracks, in a folder of its own: nothing of this checkout's builds gets in."""
    folder = tmp_path_factory.mktemp("wheel")
    tracked = subprocess.run(["git", "archive", "HEAD"], cwd=ROOT, check=True, capture_output=True).stdout
    source = folder / "source"
    source.mkdir()
    subprocess.run(["tar", "-x", "-C", str(source)], input=tracked, check=True)
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    command = [sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "--no-build-isolation", "-w", str(folder), "."]
    subprocess.run(command, cwd=source, env=os.environ | {"PATH": path}, check=True, timeout=1500)
    return next(folder.glob("*.whl"))


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_the_wheel_has_what_is_needed_at_run_time_and_no_more(wheel: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    built = sorted(name for name in names if name.endswith(".so"))
    assert [name.split(".")[0] for name in built] == [f"mgsr/native/_{family}" for family in FAMILIES]
    assert {name.split("/")[0] for name in names if ".dist-info" not in name} == {
        *("mgsr", "service", "worker", "program"),
    }
    assert "mgsr/py.typed" in names
    # NVRTC compiles these on the user's machine; the C++ files are done with.
    assert any(name.endswith(".cu") for name in names) and not any(name.endswith(".cpp") for name in names)
    assert not [name for name in names if "node_modules" in name]
    page = {name.split("/")[2] for name in names if name.startswith("service/page/")}
    assert page == {"built"} and "service/page/built/index.html" in names
    for text in ("LICENSE", "NOTICE", "THIRD_PARTY.md"):
        assert any(name.endswith(f"licenses/{text}") for name in names), text


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_the_installed_package_finds_its_example_and_reads_it(wheel: Path, tmp_path: Path) -> None:
    installed = tmp_path / "site"
    install = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--target", str(installed), str(wheel)]
    subprocess.run(install, check=True)
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    code = "from mgsr.pipeline.example import find_example; print(find_example())"
    run = [sys.executable, "-c", code]
    where = subprocess.run(
        run, cwd=tmp_path, env=environment | {"PYTHONPATH": str(installed)}, check=True, capture_output=True, text=True
    ).stdout.strip()
    assert Path(where) == installed / "mgsr/examples/glossy_knot"
    facts = subprocess.run(
        [sys.executable, "-m", "program", "info", where],
        cwd=tmp_path,
        env=environment | {"PYTHONPATH": str(installed)},
        check=True,
        capture_output=True,
        text=True,
    ).stdout
    views = {name: line for name, _, line in (fact.partition(" ") for fact in facts.splitlines())}
    assert [len(views[name].split(",")) for name in ("train_views", "test_views")] == [40, 6]
