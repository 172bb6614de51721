"""The Markdown page of a matrix, for reading; the CSV beside it has every field."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from mgsr.bench.results import DONE, Row

# Heading, field, format; None fields are dashes.
COLUMNS = (
    ("s", "seconds", ".0f"),
    ("PSNR", "psnr", ".2f"),
    ("PSNR object", "psnr_object", ".2f"),
    ("SSIM", "ssim", ".4f"),
    ("Chamfer", "chamfer", ".2f"),
    ("F 0.5%", "f_score", ".3f"),
    ("NC", "normal_consistency", ".2f"),
    ("normal error", "normal_error", ".2f"),
    ("split gain", "split_gain", ".2f"),
    ("surfels", "surfels", "d"),
    ("gaussians", "gaussians", "d"),
    ("faces", "faces", "d"),
    ("model MiB", "model_mib", ".1f"),
    ("memory MiB", "memory_mib", ".0f"),
    ("others", "others", ".1f"),
    ("commit", "commit", "s"),
)
WORDS = (
    "Chamfer is in thousandths of the object's radius, F at 0.5% of it, normal consistency (NC) times 100, the normal "
    "error in degrees, split gain in dB; `others` is the number of processors that other programs kept busy."
)


def results_page(rows: Sequence[Row], command: str) -> str:
    """Return the page: the measurements with their commands and machines, then the table, then the broken cells."""
    done = [row for row in rows if row.state == DONE]
    parts = [
        f"Last changed by `{command}`. {WORDS} The file runs.csv has the command of each run.",
        *_circumstances(done),
    ]
    parts.append(runs_table(done))
    parts += [f"Broken: {_name(row)}: {row.state.removeprefix('broken: ')}" for row in rows if row.state != DONE]
    return "\n\n".join(part for part in parts if part) + "\n"


def runs_table(rows: Sequence[Row]) -> str:
    """Return the table of the done rows."""
    if not rows:
        return ""
    head = ["scene", "variant", "method", "preset", "device", "seed", *(heading for heading, _, _ in COLUMNS)]
    cells = [
        [row.scene, row.variant or "-", row.method, row.preset, row.device, str(row.seed)]
        + [number(getattr(row, field), form) for _, field, form in COLUMNS]
        for row in rows
    ]
    return markdown(head, cells)


def markdown(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a Markdown table."""
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (head, ["---"] * len(head), *rows))


def number(value: float | str | None, form: str) -> str:
    """Format a figure, or return a dash for none."""
    return "-" if value is None or value == "" else format(value, form)


def _circumstances(rows: Sequence[Row]) -> list[str]:
    """Return the machines, versions and notes of the rows, each once, with its rows where it is not of all."""
    sentences = []
    for field, words in (("machine", "Machine"), ("versions", "Versions"), ("scored_by", "Scored by"), ("note", "")):
        for value in dict.fromkeys(getattr(row, field) for row in rows if getattr(row, field)):
            about = [row for row in rows if getattr(row, field) == value]
            sentences.append(f"{words + ': ' if words else ''}{value}{_which(about, rows)}")
    return sentences


def _which(about: Sequence[Row], rows: Sequence[Row]) -> str:
    """Name the rows that are meant, in brackets; nothing if all are.

    The shorter list is named: the rows themselves, or the others after 'all but'.
    """
    others = [row for row in rows if row not in about]
    if not others:
        return ""
    word, named = ("all but ", others) if len(others) < len(about) else ("", about)
    return f" ({word}{', '.join(map(_name, named))})"


def _name(row: Row) -> str:
    words = [row.scene, row.variant, row.method, row.preset, "" if row.device == "cpu" else row.device]
    return " ".join(word for word in (*words, f"seed {row.seed}" if row.seed else "") if word)
