"""Every CUDA kernel compiles for every generation of GPUs; the cache on disk serves several processes."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from mgsr.errors import GpuError
from mgsr.native.cuda import compiler
from mgsr.native.cuda.compiler import (
    SOURCES,
    arch_for,
    compile_family,
    default_cache_dir,
    headers_digest,
    supported_archs,
)
from mgsr.native.cuda.launcher import check_driver

FAMILIES = sorted(path.stem for path in SOURCES.glob("kernels/*/*.cu"))
ARCHS = ("sm_75", "sm_80", "sm_90", "sm_100", "sm_120")


@pytest.fixture(scope="session", autouse=True)
def nvrtc() -> None:
    """Skip the test, and say so, where NVRTC is not installed."""
    pytest.importorskip("cuda.core", reason="NEEDS NVRTC: pip install 'mgsr[cuda]'")
    try:
        supported_archs()
    except GpuError as error:
        pytest.skip(f"NEEDS NVRTC: {error}")


def test_the_families_are_found() -> None:
    assert "adam" in FAMILIES


@pytest.mark.parametrize("arch", [pytest.param(a, marks=[] if a == "sm_90" else pytest.mark.slow) for a in ARCHS])
@pytest.mark.parametrize("family", FAMILIES)
def test_compiles(family: str, arch: str, tmp_path: Path) -> None:
    assert compile_family(family, arch, tmp_path)[:4] == b"\x7fELF"


def test_a_second_compilation_reads_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = compile_family("adam", "sm_90", tmp_path)

    def fails(*arguments: object) -> bytes:
        raise AssertionError("compiled again")

    monkeypatch.setattr(compiler, "_compile", fails)
    assert compile_family("adam", "sm_90", tmp_path) == first
    with pytest.raises(AssertionError, match="compiled again"):
        compile_family("adam", "sm_80", tmp_path)


def test_a_changed_header_is_compiled_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    compile_family("adam", "sm_90", tmp_path)
    monkeypatch.setattr(compiler, "headers_digest", lambda: b"another")
    monkeypatch.setattr(compiler, "_compile", lambda *arguments: b"compiled")
    assert compile_family("adam", "sm_90", tmp_path) == b"compiled"
    assert headers_digest() != b"another"


COMPILE = """
import sys
from pathlib import Path
from mgsr.native.cuda.compiler import compile_family
print(len(compile_family("adam", "sm_90", Path(sys.argv[1]))))
"""


def sizes_in_processes(folder: Path, processes: int) -> list[int]:
    """Return how much machine code each of several processes gets that start together."""
    command = [sys.executable, "-c", COMPILE, str(folder)]
    started = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True) for _ in range(processes)]
    return [int(process.communicate()[0]) for process in started]


def entries(folder: Path) -> list[Path]:
    return [path for path in (folder / "entries").rglob("*") if path.is_file()]


def test_processes_share_the_cache(tmp_path: Path) -> None:
    sizes = sizes_in_processes(tmp_path, 3)
    assert sizes == 3 * [len(compile_family("adam", "sm_90", tmp_path))]


def test_processes_replace_a_damaged_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = compile_family("adam", "sm_90", tmp_path)
    (entry,) = entries(tmp_path)
    entry.write_bytes(whole[:1000])
    assert sizes_in_processes(tmp_path, 2) == 2 * [len(whole)]
    monkeypatch.setattr(compiler, "_compile", lambda *arguments: b"compiled")
    assert compile_family("adam", "sm_90", tmp_path) == whole


def test_without_a_usable_cache_it_compiles(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Check that kernels compile without a usable cache, as where the folder of MGSR_CUDA_CACHE lies below a file."""
    (tmp_path / "file").write_text("")
    for _ in range(2):
        assert compile_family("adam", "sm_90", tmp_path / "file" / "cache")[:4] == b"\x7fELF"
    (reported,) = caplog.messages
    assert (
        str(tmp_path / "file" / "cache") in reported and "Not a directory" in reported and "MGSR_CUDA_CACHE" in reported
    )


def test_a_user_without_a_home_has_no_cache(monkeypatch: pytest.MonkeyPatch) -> None:
    def no_home() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("MGSR_CUDA_CACHE", raising=False)
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(Path, "home", no_home)
    assert default_cache_dir() is None
    monkeypatch.setenv("XDG_CACHE_HOME", "/of/user")
    assert default_cache_dir() == Path("/of/user/mgsr/cuda")


def test_the_environment_moves_the_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MGSR_CUDA_CACHE", str(tmp_path / "here"))
    compile_family("adam", "sm_90")
    assert any((tmp_path / "here").rglob("*"))


def test_a_gpu_gets_its_own_architecture_or_the_one_before() -> None:
    assert arch_for(9, 0) == "sm_90"
    assert arch_for(12, 9)[:5] == "sm_12"
    for capability in ((6, 1), (99, 0)):
        with pytest.raises(GpuError, match=f"compute capability {capability[0]}.{capability[1]}"):
            arch_for(*capability)
    with pytest.raises(GpuError, match="sm_42"):
        compile_family("adam", "sm_42")


def test_an_old_driver_is_refused_with_the_cure() -> None:
    check_driver(13000, (13, 5))
    check_driver(14010, (13, 5))
    with pytest.raises(GpuError, match=r"driver supports CUDA 12\.4.*newer driver"):
        check_driver(12040, (13, 5))


def test_a_source_that_does_not_compile_is_shown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "kernels" / "broken"
    folder.mkdir(parents=True)
    (folder / "broken.cu").write_text("not_a_type x;")
    monkeypatch.setattr(compiler, "SOURCES", tmp_path)
    with pytest.raises(GpuError, match="not_a_type"):
        compile_family("broken", "sm_90", tmp_path / "cache")
