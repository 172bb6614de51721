"""Tests that what is passed on of others is named, with its licence."""

from __future__ import annotations

import json
import re
from importlib.metadata import distribution
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
NOTICES = (ROOT / "THIRD_PARTY.md").read_text(encoding="utf-8")


# Packages that tus-js-client needs under Node. The build fails if the bundle has code of a package without a notice.
NODE_ONLY = {
    *("buffer-from", "combine-errors", "custom-error-instance", "graceful-fs", "is-stream", "proper-lockfile", "retry"),
    *("signal-exit", "lodash.throttle", "lodash.uniqby", "lodash._baseiteratee", "lodash._basetostring"),
    *("lodash._baseuniq", "lodash._createset", "lodash._root", "lodash._stringtopath"),
}


def test_the_licence_that_is_linked_in_is_there_word_for_word() -> None:
    nanobind = distribution("nanobind")
    text = next(file for file in nanobind.files or [] if file.name == "LICENSE").read_text()
    assert text.strip() in NOTICES


def test_each_package_of_the_page_is_named() -> None:
    lock = json.loads((ROOT / "service/page/package-lock.json").read_text(encoding="utf-8"))
    shipped = [
        path.removeprefix("node_modules/") for path, facts in lock["packages"].items() if path and not facts.get("dev")
    ]
    bundled = (ROOT / "service/page/built/NOTICES.txt").read_text(encoding="utf-8").lower()
    assert shipped
    for name in set(shipped) - NODE_ONLY:
        last = re.sub(r"^@[\w-]+/", "", name)
        assert last in NOTICES.lower() and last in bundled, name
