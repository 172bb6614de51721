"""The rules of prose that a program can check: shapes, errors, and the length of paragraphs."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

from tests.docs.blocks import PAGES, ROOT

SOURCES = sorted((ROOT / "mgsr").rglob("*.py"))
PROSE = [*SOURCES, *sorted(path for name in ("service", "worker", "program") for path in (ROOT / name).rglob("*.py"))]
LONGEST_PARAGRAPH = 120
README_WORDS = 700
Function = ast.FunctionDef | ast.AsyncFunctionDef


def _public_functions(path: Path) -> Iterator[Function]:
    """Yield the public functions and methods of a module, without functions inside functions."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    bodies = [tree.body, *(node.body for node in ast.walk(tree) if isinstance(node, ast.ClassDef))]
    for node in (node for body in bodies for node in body):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and not node.name.startswith("_"):
            yield node


def _takes_or_returns_arrays(function: Function) -> bool:
    given = [*function.args.posonlyargs, *function.args.args, *function.args.kwonlyargs]
    types = [each.annotation for each in given if each.annotation] + ([function.returns] if function.returns else [])
    return any(re.search(r"\b(ndarray|Tensor)\b", ast.unparse(each)) for each in types)


def _raised_errors(function: Function) -> set[str]:
    """Return the names of the error classes that the function itself raises, not those of functions inside it."""
    inner = {
        id(node)
        for part in ast.walk(function)
        if part is not function and isinstance(part, Function)
        for node in ast.walk(part)
    }
    calls = [node.exc for node in ast.walk(function) if isinstance(node, ast.Raise) and id(node) not in inner]
    names = {ast.unparse(call.func).rpartition(".")[2] for call in calls if isinstance(call, ast.Call)}
    return {name for name in names if name.endswith("Error")}


def _arrays(function: Function) -> list[str]:
    """Return the names of the arguments that are arrays."""
    given = [*function.args.posonlyargs, *function.args.args, *function.args.kwonlyargs]
    array = re.compile(r"(np\.ndarray|(torch\.)?Tensor)( \| None)?")
    return [each.arg for each in given if each.annotation and array.fullmatch(ast.unparse(each.annotation))]


def _unshaped(function: Function, text: str) -> list[str]:
    """Return the array arguments without a shape in a docstring.

    A single array may have any shape in it. Each of several is named before its shape, in the same sentence:
    "points, normals [P,3]".
    """
    arrays = _arrays(function)
    if "[" not in text:
        return arrays or ["result"]
    return [] if len(arrays) == 1 else [each for each in arrays if not re.search(rf"\b{each}\b[^.\[]{{0,80}}\[", text)]


def _without_shapes(path: Path) -> list[str]:
    """Return the public functions of arrays, with those arrays whose shapes, such as [N,3], their docstrings lack.

    A method that implements another of its module has that one's docstring too.
    """
    functions = [function for function in _public_functions(path) if _takes_or_returns_arrays(function)]
    texts: dict[str, str] = {}
    for each in functions:
        texts[each.name] = f"{texts.get(each.name, '')} {' '.join((ast.get_docstring(each) or '').split())}"
    found = [(each.name, _unshaped(each, texts[each.name])) for each in functions]
    return [f"{path.name}: {name} {arrays}" for name, arrays in found if arrays]


def _with_unnamed_errors(path: Path) -> list[str]:
    """Return the public functions that raise errors of which their docstrings say nothing."""
    return [
        f"{path.name}: {function.name} {sorted(_raised_errors(function))}"
        for function in _public_functions(path)
        if _raised_errors(function) and not re.search(r"[Rr]aise|Error\b|errors as", ast.get_docstring(function) or "")
    ]


def _long_paragraphs(path: Path) -> list[str]:
    """Return the beginnings of the paragraphs of a page, or of a module's docstrings, that have too many words."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".md":
        text = re.sub(r"^```.*?^```$", "", text, flags=re.S | re.M)
        texts = re.split(r"\n\s*\n|\n(?=\s*(?:[-*|#]|\d+\.) ?)", text)
    else:
        nodes = (node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Module | ast.ClassDef | Function))
        texts = [part for node in nodes for part in re.split(r"\n\s*\n|\n(?=- )", ast.get_docstring(node) or "")]
    return [f"{path.name}: {each.strip()[:60]}" for each in texts if len(each.split()) > LONGEST_PARAGRAPH]


def test_public_functions_of_arrays_give_shapes() -> None:
    missing = [line for path in SOURCES for line in _without_shapes(path)]
    assert not missing, f"give shapes such as [N,3] in the docstrings of {missing}"


def test_public_functions_name_the_errors_that_they_raise() -> None:
    silent = [line for path in SOURCES for line in _with_unnamed_errors(path)]
    assert not silent, f"name the errors in the docstrings of {silent}"


def test_paragraphs_are_short() -> None:
    long = [line for path in (*PAGES, *PROSE) for line in _long_paragraphs(path)]
    assert not long, f"split these paragraphs of more than {LONGEST_PARAGRAPH} words: {long}"


def test_the_readme_is_short() -> None:
    words = len((ROOT / "README.md").read_text(encoding="utf-8").split())
    assert words <= README_WORDS, f"README.md: expected at most {README_WORDS} words, got {words}"


def test_the_checks_find_what_they_look_for(tmp_path: Path) -> None:
    module, page = tmp_path / "bad.py", tmp_path / "bad.md"
    module.write_text(
        'def mean(values: np.ndarray) -> float:\n    """Return a mean."""\n    raise ValueError("no values")\n\n'
        'def sum_of(one: Tensor, other: Tensor | None) -> Tensor:\n    """Return the sum of one [N] and other."""\n\n'
        f'def long() -> None:\n    """Do this.\n\n    {"word " * 121}"""\n'
    )
    page.write_text("# Title\n\n" + "word " * 121)
    assert _without_shapes(module) == ["bad.py: mean ['values']", "bad.py: sum_of ['other']"]
    assert _with_unnamed_errors(module) == ["bad.py: mean ['ValueError']"]
    assert len(_long_paragraphs(module)) == len(_long_paragraphs(page)) == 1
