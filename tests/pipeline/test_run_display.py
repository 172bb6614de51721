"""What a person sees of a run, on a terminal and elsewhere."""

from __future__ import annotations

import io
from pathlib import Path

import pytest
from rich.console import Console

from mgsr.errors import Cancelled, ConfigError, MgsrError, SceneError
from mgsr.pipeline.progress import Event
from mgsr.pipeline.run_display import RunDisplay
from mgsr.pipeline.run_log import training_line
from mgsr.training.progress import Progress

HALFWAY = Progress("mutual", 50, 100, 0.5, 90.0, {"photo": 0.5, "tv": 0.25}, {"surfels": 7, "gaussians": 9}, 31.5)


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


def refused(folder: Path, error: BaseException, *steps: str) -> None:
    """Make a run that ends by that error after these steps."""
    with pytest.raises(type(error)), RunDisplay(folder / "log.txt", append=False, console=QUIET) as display:
        for step in steps:
            display(Event(step, f"in {step}"))
        raise error


QUIET = Console(file=io.StringIO())


@pytest.mark.parametrize("error", [SceneError("no cameras"), ConfigError("max_side")])
def test_a_scene_that_is_refused_leaves_no_log(tmp_path: Path, error: MgsrError) -> None:
    refused(tmp_path / "new", error, "load", "load")
    assert not (tmp_path / "new").exists()
    (tmp_path / "log.txt").write_text("of an earlier run")
    refused(tmp_path, error, "load")
    assert (tmp_path / "log.txt").read_text() == "of an earlier run"


@pytest.mark.parametrize(
    ("error", "steps"),
    [
        (SceneError("no start"), ("load", "start")),
        (Cancelled("stopped on request"), ("load",)),
        (OSError("no space"), ("load",)),
    ],
)
def test_what_else_ends_a_run_is_logged(tmp_path: Path, error: Exception, steps: tuple[str, ...]) -> None:
    refused(tmp_path, error, *steps)
    lines = [line.split("s  ", 1)[1] for line in (tmp_path / "log.txt").read_text().splitlines()]
    assert lines == [*(f"in {step}" for step in steps), f"{type(error).__name__}: {error}"]
