"""Read the comments on the fields of a dataclass: a setting's comment is its documentation."""

from __future__ import annotations

import ast
import inspect
import io
import tokenize
from dataclasses import is_dataclass


def field_comments(kind: type) -> dict[str, str]:
    """Return the comment of each field of a dataclass and its bases, by the field's name.

    This is the comment on the field's lines, with following lines that continue it in lower case. Without one, it is
    the comment lines above the field.
    """
    inherited = [field_comments(base) for base in kind.__bases__ if is_dataclass(base)]
    return {name: text for texts in (*inherited, _own_comments(kind)) for name, text in texts.items()}


def _own_comments(kind: type) -> dict[str, str]:
    source = inspect.getsource(kind)
    at = {t.start[0]: (t.string.lstrip("# "), t.line.lstrip().startswith("#")) for t in _tokens(source)}
    (node,) = ast.parse(source).body
    assert isinstance(node, ast.ClassDef)
    return {ast.unparse(item.target): _comment(item, at) for item in node.body if isinstance(item, ast.AnnAssign)}


def _tokens(source: str) -> list[tokenize.TokenInfo]:
    return [t for t in tokenize.generate_tokens(io.StringIO(source).readline) if t.type == tokenize.COMMENT]


def _comment(item: ast.AnnAssign, at: dict[int, tuple[str, bool]]) -> str:
    assert item.end_lineno is not None
    words = [at[line][0] for line in range(item.lineno, item.end_lineno + 1) if line in at]
    line = item.end_lineno + 1
    if words:
        while line in at and at[line][1] and at[line][0][:1].islower():
            words.append(at[line][0])
            line += 1
    else:
        line = item.lineno - 1
        while line in at and at[line][1]:
            words.insert(0, at[line][0])
            line -= 1
    return " ".join(words)
