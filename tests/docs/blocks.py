"""The fenced blocks of the documentation, with the comments above them that say how they are run.

A block `sh` without a comment is run, in its page's order. Comments directly above a block:

- ``not run: REASON``           it can't be run here
- ``background: COMMAND``       it goes on; the page goes on once COMMAND succeeds
- ``run in: repository``        at the repository's root, by itself
- ``run: NAME``                 Python; blocks of one name are one program, which a test of that name uses
- ``curl``, ``uses: ...``       for readers of the source, and for tests that take one block alone
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
_FENCE = re.compile(r"(?:<!-- (?P<comment>[^\n]*?) -->\n)?^```(?P<language>\w*)\n(?P<text>.*?)^```$", re.S | re.M)


@dataclass(frozen=True)
class Block:
    """A fenced block; how: the comment above it."""

    page: Path
    language: str
    text: str
    how: str

    def argument(self, kind: str) -> str | None:
        """Return what the comment says behind `kind: `, if it is of that kind."""
        head, _, rest = self.how.partition(": ")
        return rest if head == kind else None


def blocks(page: Path) -> list[Block]:
    """Return a page's blocks in order."""
    text = page.read_text(encoding="utf-8")
    return [Block(page, f["language"], f["text"], f["comment"] or "") for f in _FENCE.finditer(text)]


def program(page: Path, name: str) -> str:
    """Return the Python program that a page's blocks of a name make up."""
    return "\n".join(block.text for block in blocks(page) if block.argument("run") == name)


def script(page: Path) -> str:
    """Return a page's commands as one program of bash, which ends at the first that fails."""
    parts = ["set -euo pipefail"]
    for block in blocks(page):
        if block.language != "sh" or block.argument("not run") or block.argument("run in"):
            continue
        ready = block.argument("background")
        parts.append(block.text if ready is None else _in_background(block.text.strip(), ready))
    return "\n".join(parts)


def _in_background(command: str, ready: str) -> str:
    return f"""{command} >background.log 2>&1 &
trap 'kill %1; wait %1 || true' EXIT
for i in $(seq 300); do if {ready} >/dev/null; then break; fi; sleep 0.2; done
{ready} >/dev/null"""
