"""Compiled kernels on disk: damaged files are no hits, and a folder that can't be used is told of and done without."""

from __future__ import annotations

import errno
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from mgsr.native.cuda.kernel_cache import KernelCache, kernel_cache

pytest.importorskip("cuda.core", reason="NEEDS cuda-core: pip install 'mgsr[cuda]'")

CODE = b"\x7fELF" + bytes(range(256))


def only_entry(folder: Path) -> Path:
    """Return the one file that is kept."""
    (entry,) = (path for path in (folder / "entries").rglob("*") if path.is_file())
    return entry


def test_what_is_kept_is_found(tmp_path: Path) -> None:
    KernelCache(tmp_path / "made" / "here").put(b"key", CODE)
    found = KernelCache(tmp_path / "made" / "here")
    assert found.get(b"key") == CODE and found.get(b"another") is None


def test_the_code_comes_first_in_the_file(tmp_path: Path) -> None:
    """Check that the code comes first in the file, so that NVIDIA's tools read it."""
    KernelCache(tmp_path).put(b"key", CODE)
    assert only_entry(tmp_path).read_bytes().startswith(CODE)


@pytest.mark.parametrize(
    "damage",
    [
        pytest.param(lambda stored: b"", id="empty"),
        pytest.param(lambda stored: stored[:10], id="shorter than a hash"),
        pytest.param(lambda stored: stored[:-1], id="truncated"),
        pytest.param(lambda stored: stored[: len(stored) // 2], id="half"),
        pytest.param(lambda stored: bytes([stored[0] ^ 1]) + stored[1:], id="a bit altered"),
        pytest.param(lambda stored: bytes(len(stored)), id="zeros"),
        pytest.param(lambda stored: b"garbage" * 1000, id="garbage"),
        pytest.param(lambda stored: CODE, id="kept without a hash"),
    ],
)
def test_a_damaged_file_is_no_hit_and_is_replaced(
    damage: Callable[..., Any], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    kept = KernelCache(tmp_path)
    kept.put(b"key", CODE)
    entry = only_entry(tmp_path)
    entry.write_bytes(damage(entry.read_bytes()))
    assert kept.get(b"key") is None
    kept.put(b"key", CODE)
    assert kept.get(b"key") == CODE and not caplog.messages


def test_a_file_under_another_name_is_no_hit(tmp_path: Path) -> None:
    kept = KernelCache(tmp_path)
    kept.put(b"key", CODE)
    entry, stored = only_entry(tmp_path), only_entry(tmp_path).read_bytes()
    entry.unlink()
    kept.put(b"another", b"other code")
    only_entry(tmp_path).write_bytes(stored)
    assert kept.get(b"another") is None


def failing(code: int) -> Callable[..., None]:
    """Return a stand-in for a function of the system that fails with an error code."""

    def fail(*arguments: object, **named: object) -> None:
        raise OSError(code, os.strerror(code))

    return fail


@pytest.mark.parametrize(
    ("module", "call", "code"),
    [
        (os, "fsync", errno.ENOSPC),
        (tempfile, "mkstemp", errno.EROFS),
        (tempfile, "mkstemp", errno.EACCES),
        (os, "replace", errno.EIO),
    ],
)
def test_a_folder_that_can_not_be_written_is_told_of_once(
    module: ModuleType,
    call: str,
    code: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    """Check that a folder that can't be written is told of once, and that what lies there serves on."""
    kept = kernel_cache(tmp_path)
    kept.put(b"before", CODE)
    monkeypatch.setattr(module, call, failing(code))
    for key in (b"first", b"second"):
        kernel_cache(tmp_path).put(key, CODE)
        assert kernel_cache(tmp_path).get(key) is None
    (reported,) = caplog.messages
    assert str(tmp_path) in reported and os.strerror(code) in reported and "MGSR_CUDA_CACHE" in reported
    assert kept.get(b"before") == CODE


@pytest.mark.parametrize("place", ["file", "file/below", "link", "/proc/mgsr"])
def test_a_folder_that_is_none_is_told_of_once(place: str, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "link").symlink_to("link")
    kept = KernelCache(tmp_path / place)
    assert kept.get(b"key") is None
    kept.put(b"key", CODE)
    assert kept.get(b"key") is None
    assert len(caplog.messages) == 1


def test_a_file_that_can_not_be_read_is_told_of(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    kept = KernelCache(tmp_path)
    kept.put(b"key", CODE)
    entry = only_entry(tmp_path)
    entry.unlink()
    entry.mkdir()
    assert kept.get(b"key") is None
    kept.put(b"key", CODE)
    assert len(caplog.messages) == 1


def test_without_a_folder_nothing_is_kept(caplog: pytest.LogCaptureFixture) -> None:
    kept = KernelCache(None)
    kept.put(b"key", CODE)
    assert kept.get(b"key") is None and "MGSR_CUDA_CACHE" in caplog.text
