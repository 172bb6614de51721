"""The folder of results: few files, each only ever added to and flushed, so that what was measured stays."""

from __future__ import annotations

import json
import os
import threading
import zipfile
from pathlib import Path
from typing import Any

SUMMARY, LOG, TESTS, BENCHMARK = "summary.md", "log.txt", "tests.txt", "benchmark.md"
PROFILE, ROWS, SPLATS = "profile.md", "results.jsonl", "splats.zip"
# One less than a machine that is lent brings home, for splats.zip while it is being written anew.
FILES = (SUMMARY, LOG, TESTS, BENCHMARK, PROFILE, ROWS, SPLATS)
LARGEST = 15 * 2**20  # bytes of a file


class Results:
    """The files of one folder, which may hold those of earlier calls: they are added to."""

    def __init__(self, folder: Path, largest: int = LARGEST) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.folder = folder.resolve()
        self._largest = largest
        self._lock = threading.Lock()  # of the threads that follow steps' output

    def add(self, name: str, text: str) -> None:
        """Append text to a file, which is on disk then; a file that is full takes no more."""
        path, content = self.folder / name, text.encode(errors="replace")
        with self._lock, path.open("ab") as file:
            if file.tell() + len(content) <= self._largest:
                file.write(content)
            elif file.tell() < self._largest:
                file.write(b"\n(the rest is left out: the file is full)\n".ljust(self._largest - file.tell()))

    def row(self, **facts: Any) -> None:
        """Append one line of JSON to results.jsonl."""
        self.add(ROWS, json.dumps(facts) + "\n")

    def rows(self, step: str) -> list[dict[str, Any]]:
        """Return what steps of that name have appended, oldest first."""
        path = self.folder / ROWS
        lines = path.read_text().splitlines() if path.is_file() else []
        return [row for row in map(json.loads, lines) if row["step"] == step]

    def keep_splats(self, scene: str, files: list[Path]) -> int:
        """Put a scene's files into splats.zip, in place of those of an earlier training, and return the archive's size.

        The archive is there whole or not at all. Where it would be too large, nothing is changed, and 0 is returned.
        """
        target = self.folder / SPLATS
        unfinished = target.with_name("splats_unfinished.zip")
        with zipfile.ZipFile(unfinished, "w") as archive:
            for name, content in self._kept_splats(scene):
                archive.writestr(name, content, zipfile.ZIP_LZMA)
            for file in files:
                archive.write(file, f"{scene}/{file.name}", zipfile.ZIP_LZMA)
        size = unfinished.stat().st_size
        if size > self._largest:
            unfinished.unlink()
            return 0
        os.replace(unfinished, target)
        return size

    def _kept_splats(self, but: str) -> list[tuple[str, bytes]]:
        target = self.folder / SPLATS
        if not target.is_file():
            return []
        with zipfile.ZipFile(target) as archive:
            return [(name, archive.read(name)) for name in archive.namelist() if not name.startswith(f"{but}/")]


def tell(text: str) -> None:
    """Print a line that the summary takes up."""
    print(f"{TOLD}{text}", flush=True)


TOLD = "result: "
