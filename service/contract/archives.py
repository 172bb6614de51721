"""Archives in the store. Each is one object, or the folder of a resumable upload's parts.

uploads/<job>.<upload>                     an archive uploaded in one request
uploads/<job>.<upload>/<begin>.<random>    a part of a resumable upload; begin: the offset of its first byte
"""

from __future__ import annotations

import secrets
import time
from collections import defaultdict
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from service.contract.store import Entry, Store

FOLDER = "uploads"
# If no job names an archive after this many seconds, its service was killed during the upload.
STALE_SECONDS = 6 * 3600.0
_COPIES_AT_ONCE = 8


def archive_path(job: str, upload: str) -> str:
    """Return the key of a job's archive."""
    return f"{FOLDER}/{job}.{upload}"


def new_part(archive: str, begin: int) -> str:
    """Return a new key for a part whose first byte has the offset `begin`. Each call returns another key."""
    return f"{archive}/{begin:015d}.{secrets.token_hex(4)}"


class Archives:
    """The archives of one store."""

    def __init__(self, store: Store) -> None:
        self._store = store

    def parts(self, archive: str) -> list[Entry]:
        """Return the parts that follow each other without gaps from byte 0 on; none if the archive is one object.

        A broken connection and its successor may write parts that begin at the same byte. The longest of them counts.
        """
        longest: dict[int, Entry] = {}
        for entry in self._store.entries(archive):
            begin = int(entry.key.removeprefix(f"{archive}/").partition(".")[0])
            if begin not in longest or longest[begin].size < entry.size:
                longest[begin] = entry
        found, end = [], 0
        while (part := longest.get(end)) is not None and part.size > 0:
            found.append(part)
            end += part.size
        return found

    def download(self, archive: str, path: Path) -> None:
        """Write an archive to a file. Raises StoreError if there is none."""
        self._store.download(path, *([part.key for part in self.parts(archive)] or [archive]))

    def copy(self, archive: str, target: str) -> bool:
        """Copy an archive, and return whether it existed."""
        parts = self.parts(archive)
        if not parts:
            return self._store.copy(archive, target)
        copies = [(part.key, f"{target}{part.key.removeprefix(archive)}") for part in parts]
        with ThreadPoolExecutor(_COPIES_AT_ONCE) as pool:
            return all(pool.map(lambda copy: self._store.copy(*copy), copies))

    def delete(self, archive: str) -> None:
        """Delete an archive, if it exists."""
        self._store.delete_all(archive)
        self._store.delete(archive)

    def sweep(self, wanted: Callable[[str], bool]) -> None:
        """Delete stale archives that are not wanted, complete or not. They come from killed services."""
        self._store.delete_unfinished(FOLDER, STALE_SECONDS)
        touched: dict[str, float] = defaultdict(float)
        for entry in self._store.entries(FOLDER):
            archive = "/".join(entry.key.split("/")[:2])
            touched[archive] = max(touched[archive], entry.modified.timestamp())
        for archive, last in touched.items():
            if time.time() - last > STALE_SECONDS and not wanted(archive):
                self.delete(archive)
