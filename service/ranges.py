"""Parse the header Range (RFC 9110)."""

from __future__ import annotations

import re

from service.problems import Problem

_ONE = re.compile(r"\s*bytes\s*=\s*(\d{0,19})\s*-\s*(\d{0,19})\s*", re.ASCII)


def parse_range(text: str | None, size: int) -> tuple[int, int] | None:
    """Return the first byte of a range and the byte after its last, or None to send the whole file.

    text: the header, None without one. size: the file's size in bytes. As the RFC allows, several ranges and other
    units also mean the whole file. Raises Problem 416 if the range contains no byte of the file.
    """
    found = _ONE.fullmatch(text or "")
    if found is None or not (found[1] or found[2]):
        return None
    if found[1]:
        start, end = int(found[1]), min(int(found[2]) + 1 if found[2] else size, size)
        if found[2] and int(found[2]) < int(found[1]):
            return None
    else:
        start, end = max(0, size - int(found[2])), size
    if start >= end:
        raise Problem(
            416,
            "range_outside",
            f"Range: expected a range within the file's {size} bytes, got {text!r}",
            {"Content-Range": f"bytes */{size}"},
        )
    return start, end
