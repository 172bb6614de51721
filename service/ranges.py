"""Parse the header Range (RFC 9110)."""

from __future__ import annotations

import re

from service.problems import Problem

_ONE = re.compile(r"\s*bytes\s*=\s*(\d{0,19})\s*-\s*(\d{0,19})\s*", re.ASCII)


def parse_range(text: str | None, size: int) -> tuple[int, int] | None:
    """Return the first byte and the one after the last; None where all of `size` bytes are to be sent.

    All are sent without the header, and, as the RFC allows, for several ranges or other units. Raises Problem 416 where
    no byte lies in the range.
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
            f"the file has {size} bytes, none of them in {text!r}",
            {"Content-Range": f"bytes */{size}"},
        )
    return start, end
