"""The addresses of unfinished uploads, kept in a folder so that a later process can continue them."""

from __future__ import annotations

import hashlib
import os
import time
from contextlib import suppress
from pathlib import Path

_FORGOTTEN = 30 * 86400.0  # seconds after which an address is deleted; services delete uploads sooner


def default_folder() -> Path:
    """Return the folder in which `mgsr submit` keeps the addresses: ~/.local/state/mgsr/uploads, by the XDG rules."""
    return Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local/state") / "mgsr/uploads"


class UnfinishedUploads:
    """The addresses of unfinished uploads by their fingerprints, each in a small file.

    folder: created when needed; None keeps nothing. If it can't be written, uploads work but can't be resumed.
    """

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder

    @property
    def kept(self) -> bool:
        """Return whether addresses are kept."""
        return self._folder is not None

    def find(self, fingerprint: str) -> str | None:
        """Return the address of an upload, or None if it is unknown."""
        if self._folder is None:
            return None
        try:
            return (self._folder / fingerprint).read_text().strip() or None
        except OSError:
            return None

    def keep(self, fingerprint: str, address: str) -> None:
        """Keep the address of an upload, and delete addresses that are a month old."""
        if self._folder is None:
            return
        with suppress(OSError):
            self._folder.mkdir(parents=True, exist_ok=True, mode=0o700)
            for path in self._folder.iterdir():
                if time.time() - path.stat().st_mtime > _FORGOTTEN:
                    path.unlink()
            (self._folder / fingerprint).write_text(address)

    def forget(self, fingerprint: str) -> None:
        """Delete the address of an upload."""
        if self._folder is not None:
            with suppress(OSError):
                (self._folder / fingerprint).unlink()


def fingerprint(server: str, key: str | None, options: str, archive: Path) -> str:
    """Return the fingerprint of an upload: the SHA-256 of service, key, options and the archive's bytes."""
    with archive.open("rb") as file:
        content = hashlib.file_digest(file, "sha256").hexdigest()
    return hashlib.sha256("\0".join([server, key or "", options, content]).encode()).hexdigest()
