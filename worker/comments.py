"""Read the comments on dataclass fields in a source file: a setting's comment is its documentation."""

from __future__ import annotations

import ast
import io
import tokenize


def field_comments(source: str) -> dict[str, dict[str, str]]:
    """Return the comment of each field, by class and field.

    It is the comment on the field's lines, with the lines below it that continue it in lower case. Without one, it is
    the comment lines above.
    """
    at = {t.start[0]: (t.string.lstrip("# "), t.line.lstrip().startswith("#")) for t in _tokens(source)}
    found: dict[str, dict[str, str]] = {}
    for node in ast.parse(source).body:
        if isinstance(node, ast.ClassDef):
            fields = [item for item in node.body if isinstance(item, ast.AnnAssign)]
            found[node.name] = {ast.unparse(item.target): _comment(item, at) for item in fields}
    return found


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
