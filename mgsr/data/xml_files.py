"""Read a capture's XML, which may be hostile: document types are refused and unneeded parts skipped."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element
from xml.parsers import expat

from mgsr.data.odd_files import require_content
from mgsr.errors import SceneError, in_short


def read_xml(path: Path, left_out: Collection[str] = ()) -> Element:
    """Return the root of an XML file, in any encoding that it declares.

    left_out: tags of elements that stay empty, so that their content takes no memory. Raises SceneError for files that
    are not XML, and for XML with a DOCTYPE: its entities could fill the memory.
    """
    require_content(path)
    try:
        _refuse_document_type(path)
        return _parsed(path, frozenset(left_out))
    except (ElementTree.ParseError, expat.ExpatError, OSError, RecursionError, ValueError, LookupError) as error:
        raise SceneError(f"{path.name}: not valid XML: {in_short(error)}; export it again") from error


def _parsed(path: Path, left_out: frozenset[str]) -> Element:
    events: Any = ElementTree.iterparse(path, events=("end",))
    for _, element in events:
        if element.tag in left_out:
            element.clear()
    root: Element = events.root
    return root


class _RootReachedError(Exception):
    """The document's first element begins, so no DOCTYPE can follow."""


def _refuse_document_type(path: Path) -> None:
    """Raise SceneError where the file has a DOCTYPE, before any of its entities is read."""

    def refuse(*_: Any) -> None:
        """Raise SceneError for the DOCTYPE."""
        raise SceneError(f"{path.name}: the file has a DOCTYPE, which no program writes there; MGSR refuses it")

    def stop(*_: Any) -> None:
        """Raise _RootReachedError at the first element."""
        raise _RootReachedError

    parser = expat.ParserCreate()
    parser.StartDoctypeDeclHandler = refuse
    parser.StartElementHandler = stop
    try:
        with path.open("rb") as file:
            parser.ParseFile(file)
    except _RootReachedError:
        return
