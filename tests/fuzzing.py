"""Damage to files, for readers that must refuse what they can't read with one error of ours.

The short run uses the same examples each time; the slow one looks for new ones, each parser for ten minutes of
processor time, or as many seconds as MGSR_FUZZ_SECONDS says: `python -m pytest -m slow -k for_long tests/data
tests/export`.
"""

from __future__ import annotations

import copy
import json
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mgsr.errors import MgsrError

QUICK = settings(max_examples=25, derandomize=True, deadline=None, suppress_health_check=list(HealthCheck))
LONG = settings(max_examples=300, deadline=None, suppress_health_check=list(HealthCheck))
SECONDS = float(os.environ.get("MGSR_FUZZ_SECONDS", "600"))


# What is changed: bytes of any file, and values of JSON files.

Change = Callable[[bytes], bytes]

_TOKENS = [b"nan", b"-inf", b"1e999", b"-1", b"0", b"", b"\x00", b"\xff\xff\xff\xff\xff\xff\xff\x7f", b",", b" ", b"\n"]
_VALUES: list[object] = [
    None,
    True,
    -1,
    0,
    1e308,
    10**30,
    float("nan"),
    float("inf"),
    "",
    "../x",
    "a\x00b",
    "\ud800",
    [],
    {},
    [[]],
    [None] * 4,
]


def fuzz(
    path: Path, read: Callable[[], object], refusal: type[MgsrError], changes: st.SearchStrategy[Change], how: settings
) -> None:
    """Read a file with changes in it: that must work or raise `refusal` with a short message.

    In the short run it is read once; in the slow one with ever new examples until the time is up.
    """
    whole = path.read_bytes()

    @how
    @given(changes)
    def run(change: Change) -> None:
        path.write_bytes(change(whole))
        try:
            read()
        except refusal as error:
            assert len(str(error)) < 1000

    end = time.process_time() + SECONDS
    run()
    while how is LONG and time.process_time() < end:
        run()


@st.composite
def byte_changes(draw: Any) -> Change:
    """Draw a few edits: bytes flipped, cut out, doubled, or replaced by words that parsers dislike."""
    edits = draw(
        st.lists(st.tuples(st.floats(0, 1), st.integers(0, 12), st.sampled_from(_TOKENS)), min_size=1, max_size=4)
    )
    kinds = draw(st.lists(st.sampled_from(["flip", "cut", "insert", "replace", "truncate"]), min_size=4, max_size=4))

    def change(data: bytes) -> bytes:
        for (place, count, token), kind in zip(edits, kinds, strict=False):
            at = int(place * len(data))
            match kind:
                case "flip":
                    data = data[:at] + bytes(255 ^ byte for byte in data[at : at + 1]) + data[at + 1 :]
                case "cut":
                    data = data[:at] + data[at + count :]
                case "insert":
                    data = data[:at] + token + data[at:]
                case "replace":
                    data = data[:at] + token + data[at + max(count, len(token)) :]
                case "truncate":
                    data = data[:at]
        return data

    return change


@st.composite
def value_changes(draw: Any) -> Change:
    """Draw values somewhere in a JSON document that are replaced or removed."""
    edits = draw(
        st.lists(
            st.tuples(st.lists(st.integers(0, 30), min_size=1, max_size=6), st.sampled_from([*_VALUES, "REMOVE"])),
            min_size=1,
            max_size=3,
        )
    )

    def change(data: bytes) -> bytes:
        document = json.loads(data)
        for path, value in edits:
            _put(document, path, value)
        return json.dumps(document).encode()

    return change


def _put(node: Any, path: list[int], value: Any) -> None:
    """Follow the path as far as it goes, and change what is there."""
    while isinstance(node, (dict, list)) and node:
        keys = list(node) if isinstance(node, dict) else list(range(len(node)))
        key = keys[path[0] % len(keys)]
        path = path[1:]
        if not path or not isinstance(node[key], (dict, list)) or not node[key]:
            if value == "REMOVE":
                del node[key]
            else:
                node[key] = copy.deepcopy(value)  # a list put into itself has no end
            return
        node = node[key]
