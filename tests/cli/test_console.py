"""What a person sees of a run, on a terminal and elsewhere."""

from __future__ import annotations

import io
from pathlib import Path

import pytest
from rich.console import Console

from mgsr.cli.console import RunDisplay, training_line
from mgsr.cli.events import Event
from mgsr.training.progress import Progress

HALFWAY = Progress("mutual", 50, 100, 0.5, 90.0, {"photo": 0.5, "tv": 0.25}, {"surfels": 7, "volumes": 9}, 31.5)


def shown(tmp_path: Path, terminal: bool) -> str:
    console = Console(file=io.StringIO(), force_terminal=terminal, width=160, color_system=None)
    with RunDisplay(tmp_path / "log.txt", append=False, console=console) as display:
        display(Event("load", "reading [scene]"))
        display(Event("train", "mutual", HALFWAY))
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


@pytest.mark.parametrize("terminal", [False, True])
def test_the_same_facts_on_a_terminal_and_elsewhere(tmp_path: Path, terminal: bool) -> None:
    text = shown(tmp_path, terminal)
    for fact in ("reading [scene]", "mutual 50/100", "loss 0.7500", "PSNR 31.50 dB", "7 surfels", "1:30 left"):
        assert fact in text


def test_the_log_has_every_line_and_grows_on_resume(tmp_path: Path) -> None:
    shown(tmp_path, terminal=False)
    with pytest.raises(RuntimeError), RunDisplay(tmp_path / "log.txt", append=True) as display:
        display(Event("load", "once more"))
        raise RuntimeError("power cut")
    lines = (tmp_path / "log.txt").read_text().splitlines()
    assert [line.split("s  ", 1)[1] for line in lines] == [
        *("reading [scene]", training_line(HALFWAY), "once more", "RuntimeError: power cut"),
    ]
