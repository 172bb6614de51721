"""Hooks of mkdocs (mkdocs.yml).

They convert formulas to MathML, which browsers show without scripts. They insert the tables of settings from
mgsr/config, add generated pages to the menu, and turn links into the sources into names of files.
"""

from __future__ import annotations

import html
import re
import sys
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))  # mkdocs loads this file by its path

from scripts.options_page import expert_markdown, paper_markdown, settings_markdown  # noqa: E402

TABLES = {
    "<!-- settings of mgsr/config -->": settings_markdown,
    "<!-- settings of mgsr/config/paper.py -->": paper_markdown,
    "<!-- settings of mgsr/config/expert -->": expert_markdown,
}
FORMULA = re.compile(r'<(span|div) class="arithmatex">\\([(\[])(.*?)\\[)\]]</\1>', re.S)
# Pages that other scripts make from measurements. The menu has those that exist.
MADE = {"evidence.md": "Evidence"}


def on_config(config: Any) -> Any:
    """Add the generated pages to the part "Understand" of the menu."""
    part = next(entry["Understand"] for entry in config["nav"] if "Understand" in entry)
    part += [{title: name} for name, title in MADE.items() if (Path(config["docs_dir"]) / name).is_file()]
    return config


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Insert the tables of settings at their marks, and turn links that leave docs/ into names of files."""
    for mark, table in TABLES.items():
        if mark in markdown:
            markdown = markdown.replace(mark, table())
    return re.sub(r"\[([^\]]+)\]\(\.\./([^)]+)\)", r"\1 (`\2`)", markdown)


def on_page_content(text: str, **_: Any) -> str:
    """Convert LaTeX to MathML."""
    return FORMULA.sub(_formula, text)


def _formula(found: re.Match[str]) -> str:
    display = "block" if found[2] == "[" else "inline"
    return convert(html.unescape(found[3]).strip(), display=display)
