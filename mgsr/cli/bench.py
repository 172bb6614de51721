"""`mgsr bench`: a matrix of runs, one table and plots of speed against error."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mgsr.cli.options import refusals
from mgsr.errors import ConfigError
from mgsr.pipeline.stop_signals import INTERRUPTED, stop_on_signals

if TYPE_CHECKING:
    from mgsr.bench.cells import Cell
    from mgsr.bench.matrix import Bench

ScenesArgument = Annotated[
    list[Path], typer.Argument(metavar="SCENE...", help="Folders or archives of posed photographs.")
]
OutOption = Annotated[
    Path, typer.Option("--out", "-o", metavar="OUT", help="The folder for the runs, the table and the plots.")
]
MethodsOption = Annotated[str, typer.Option(help="The methods, separated by commas: mgsr, 2dgs, 3dgs.")]
PresetsOption = Annotated[str, typer.Option(help="The presets, separated by commas: draft, standard, high.")]
DevicesOption = Annotated[str, typer.Option(help="The devices, separated by commas: cpu, cuda.")]
SeedsOption = Annotated[str, typer.Option(help="The seeds, separated by commas.")]
VariantOption = Annotated[
    list[str] | None,
    typer.Option(
        help="A variant: plain, an ablation row (A to N), ablations (all rows), paper-choices, needs, or "
        "KEY=VALUE[,KEY=VALUE]. Repeat it for several. The default is plain."
    ),
]
SettingsOption = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="A setting of every run. Repeat it for several settings."),
]
EvaluateOption = Annotated[
    Path | None, typer.Option(metavar="PATH", help="A script that scores the runs, in place of their reports.")
]
KeepOption = Annotated[Path | None, typer.Option(metavar="FOLDER", help="A folder whose tables also receive the rows.")]
AnyCommitOption = Annotated[
    bool, typer.Option("--any-commit", help="Also accept finished runs of other commits of the program.")
]


def bench(
    scenes: ScenesArgument,
    out: OutOption,
    methods: MethodsOption = "mgsr",
    presets: PresetsOption = "standard",
    devices: DevicesOption = "cpu",
    seeds: SeedsOption = "0",
    variant: VariantOption = None,
    settings: SettingsOption = None,
    evaluate: EvaluateOption = None,
    keep: KeepOption = None,
    any_commit: AnyCommitOption = False,
) -> None:
    """Run every SCENE with every method, preset, device, seed and variant, one after another.

    Each run has its own process. OUT receives runs.csv, runs.md, curves.csv and plots. Finished runs in OUT are not
    repeated. A failed run is reported, and the others continue.
    """
    from mgsr.bench.cells import matrix, read_variants
    from mgsr.bench.machine import program_commit
    from mgsr.bench.matrix import Bench
    from mgsr.bench.results import told_command

    with refusals():
        numbers = [_whole_number(word) for word in _words(seeds)]
        wanted = read_variants(variant or ["plain"], settings or [])
        cells = matrix(scenes, _words(methods), _words(presets), _words(devices), numbers, wanted)
        command = told_command(sys.argv[1:])
        folders = (out,) if keep is None else (out, keep)
        code = _run(cells, Bench(out, program_commit(), command, folders, evaluate, any_commit))
    raise typer.Exit(code)


def _run(cells: list[Cell], bench: Bench) -> int:
    """Run the cells, and return the exit code: 0, 1 if a cell broke, 130 if it was stopped."""
    from mgsr.bench.matrix import run_matrix
    from mgsr.bench.plots import have_matplotlib, write_plots
    from mgsr.bench.results import CURVES, DONE, RUNS, latest, read_curves, read_rows
    from mgsr.bench.running import Stopped

    try:
        with stop_on_signals() as stop:
            rows, _ = run_matrix(cells, bench, print, stop)
    except Stopped:
        print("Stopped. The same command continues with the interrupted run.", file=sys.stderr)
        return INTERRUPTED
    if have_matplotlib():
        write_plots(bench.out, latest(read_rows(bench.out / RUNS)), read_curves(bench.out / CURVES))
    else:
        print("No plots: matplotlib is not installed. Run pip install 'mgsr[bench]'.")
    broken = sum(row.state != DONE for row in rows)
    print(f"{bench.out / RUNS}: {len(rows) - broken} of {len(rows)} runs have results")
    return 1 if broken else 0


def _words(text: str) -> list[str]:
    return [word.strip() for word in text.split(",") if word.strip()]


def _whole_number(word: str) -> int:
    if not word.isdigit():
        raise ConfigError(f"--seeds: expected whole numbers separated by commas, got {word!r}")
    return int(word)
