"""The arguments that each step's module takes."""

from __future__ import annotations

import argparse
from pathlib import Path

from benchmarks.gpu_check.results import Results


def parser(description: str | None) -> argparse.ArgumentParser:
    """Return a parser of what every step is given; `results_of`, `work_of` and the attribute device read it."""
    made = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    made.add_argument("--results", type=Path, required=True, help="the folder for the results")
    made.add_argument("--work", type=Path, required=True, help="the folder for files that stay on the machine")
    made.add_argument("--device", default="cuda", help="cuda, or cpu to test the step without a GPU")
    return made


def results_of(args: argparse.Namespace) -> Results:
    """Return the results that the arguments name."""
    return Results(args.results)


def work_of(args: argparse.Namespace) -> Path:
    """Return the folder that the arguments name, made where it is not there."""
    work: Path = args.work.resolve()
    work.mkdir(parents=True, exist_ok=True)
    return work


def require_gpu(device: str) -> None:
    """End the process with a message, and code 1, where cuda is asked for and torch can use no GPU."""
    import torch

    if device == "cuda" and not torch.cuda.is_available():
        built = "is built for the CPU only" if torch.version.cuda is None else "sees no NVIDIA GPU or driver"
        raise SystemExit(f"no GPU: the installed torch {built}")
