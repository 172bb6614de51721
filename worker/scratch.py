"""Scratch folders for attempts, which are removed soon after their worker ends, however it dies."""

from __future__ import annotations

import fcntl
import os
import secrets
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

ATTEMPTS, PAUSE = 10, 0.1  # the attempts to remove a folder, and the seconds between two of them


@contextmanager
def scratch_folder(root: Path, name: str) -> Iterator[Path]:
    """Yield a new folder under `root`, which is removed at the block's end.

    A lock beside it tells `sweep` that the folder is in use. The kernel releases the lock when this process dies. If
    the folder cannot be removed, the lock's file stays, and `sweep` tries again.
    """
    root.mkdir(parents=True, exist_ok=True, mode=0o700)
    folder = root / f"{name}.{secrets.token_hex(4)}"
    lock = _hold(folder.with_suffix(folder.suffix + ".lock"))
    try:
        folder.mkdir(mode=0o700)
        yield folder
    finally:
        if _removed(folder):
            _drop(folder.with_suffix(folder.suffix + ".lock"))
        os.close(lock)


def sweep(root: Path) -> None:
    """Remove the folders of dead workers."""
    for lock in root.glob("*.lock"):
        with suppress(OSError):
            handle = os.open(lock, os.O_RDWR)
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                if _removed(lock.with_suffix("")):
                    _drop(lock)
            finally:
                os.close(handle)


def _removed(folder: Path) -> bool:
    """Remove a folder, and return whether it is gone.

    A process that is just being killed may still write into it, which makes single attempts fail.
    """
    for attempt in range(ATTEMPTS):
        if attempt:
            time.sleep(PAUSE)
        shutil.rmtree(folder, ignore_errors=True)
        if not folder.exists():
            return True
    return False


def _hold(path: Path) -> int:
    """Create and lock a file, and return its descriptor. If `sweep` removes the file in between, create it again."""
    while True:
        handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o600)
        fcntl.flock(handle, fcntl.LOCK_EX)
        with suppress(FileNotFoundError):
            if os.fstat(handle).st_ino == path.stat().st_ino:
                return handle
        os.close(handle)


def _drop(path: Path) -> None:
    path.unlink(missing_ok=True)
