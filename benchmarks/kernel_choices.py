"""Time and error of the rasterizers with one choice of theirs made otherwise:

    PYTHONPATH=. python benchmarks/kernel_choices.py ../shared/data/raster [--keep benchmarks/results]

Each choice is a line of the C++ sources. It is changed in a copy of them, which is built beside and measured as
`kernels.py` does, on this processor's best vector variant; the sources as they are come first. It takes some minutes,
most of them the compiler's. With --keep the rows go to kernel_choices.csv.
"""

from __future__ import annotations

import argparse
import importlib.util
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from mgsr.bench.kernel_page import kernel_table
from mgsr.bench.kernel_results import AS_IT_IS
from mgsr.bench.kernel_results import CHOICES as CHOICES_FILE

ROOT = Path(__file__).parents[1]
RASTERIZERS = ("_volumes", "_surfels")
COMMON = "mgsr/native/kernels/common/"
TILE = "constexpr int kTile = 16;"
TERMS = "kTerms[] = {9.6755410e-3f, 5.5507131e-2f, 2.4022120e-1f, 6.9314694e-1f, 1.0000001f};"
FIRST = "p[i] = splat(1.3276479e-3f);"
EXP2 = "  const vfloat shifter = splat(12582912.0f);"


@dataclass(frozen=True)
class Change:
    """A piece of a source file that is replaced."""

    file: str
    old: str
    new: str


@dataclass(frozen=True)
class Choice:
    name: str
    changes: tuple[Change, ...] = ()


CHOICES = (
    Choice(AS_IT_IS),
    Choice("tiles of 8 x 8", (Change(COMMON + "binning.h", TILE, "constexpr int kTile = 8;"),)),
    # Least squares of the relative error at Chebyshev's points, as for the degree that is used.
    Choice(
        "2^x of degree 3",
        (
            Change(COMMON + "simd.h", TERMS, "kTerms[] = {2.4260405e-1f, 6.9327624e-1f, 9.9992894e-1f};"),
            Change(COMMON + "simd.h", FIRST, "p[i] = splat(5.5088684e-2f);"),
        ),
    ),
    Choice(
        "2^x of the C library",
        (
            Change(
                COMMON + "simd.h",
                EXP2,
                "  for (int i = 0; i < Count; ++i)\n"
                "    for (int lane = 0; lane < kWidth; ++lane) x[i][lane] = __builtin_exp2f(x[i][lane]);\n"
                "  return;\n" + EXP2,
            ),
        ),
    ),
)  # fmt: skip


def changed_sources(choice: Choice, folder: Path) -> None:
    """The native sources in `folder`, with the choice made."""
    shutil.copytree(ROOT / "mgsr" / "native", folder / "mgsr" / "native", ignore=shutil.ignore_patterns("*.so"))
    shutil.copy(ROOT / "CMakeLists.txt", folder)
    for change in choice.changes:
        file = folder / change.file
        text = file.read_text()
        if text.count(change.old) != 1:
            raise SystemExit(f"{change.file}: expected {change.old!r} once, got it {text.count(change.old)} times")
        file.write_text(text.replace(change.old, change.new))


def build(folder: Path) -> None:
    """The rasterizers' modules, beside their sources."""
    tools = Path(sys.executable).parent
    python = f"-DPython_EXECUTABLE={sys.executable}"
    configure = [tools / "cmake", "-S", folder, "-B", folder / "build", "-DCMAKE_BUILD_TYPE=Release", python]
    subprocess.run(configure, check=True, stdout=subprocess.DEVNULL)
    make = [tools / "cmake", "--build", folder / "build", "--parallel", "--target", *RASTERIZERS]
    subprocess.run(make, check=True, stdout=subprocess.DEVNULL)


def measure(choice: str, built: Path, args: argparse.Namespace) -> None:
    """The rasterizers in `built`, which take the place of the installed ones in this process."""
    for name in RASTERIZERS:
        file = next((built / "mgsr" / "native").glob(f"{name}.*.so"))
        spec = importlib.util.spec_from_file_location(f"mgsr.native.{name}", file)
        if spec is None or spec.loader is None:
            raise SystemExit(f"{file}: can't be loaded")
        module = importlib.util.module_from_spec(spec)
        sys.modules[f"mgsr.native.{name}"] = module
        spec.loader.exec_module(module)
    from benchmarks import kernels
    from mgsr.native import runtime

    runtime.set_threads(0)
    isa = runtime.isas()[0]
    found = [
        kernels.rows_of(case, [isa], args.runs, args.note)[0]
        for case in kernels.raster_cases(args.folder / f"{args.scene}.npz")
    ]
    rows = [replace(row, variant=choice) for row in found]
    print(kernel_table(rows), flush=True)
    if args.keep is not None:
        kernels.keep(args.keep / CHOICES_FILE, rows)


def main(arguments: Sequence[str]) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="the raster scenes")
    parser.add_argument("--scene", default="s20k_256")
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--note", default="", help="what else is to be known of the machine")
    parser.add_argument("--keep", type=Path, help="a results folder")
    parser.add_argument("--built", type=Path, help="measure the rasterizers that were built here, nothing else")
    parser.add_argument("--choice", help="what they are called")
    args = parser.parse_args(arguments)
    if args.built is not None:
        measure(args.choice, args.built, args)
        return
    with tempfile.TemporaryDirectory() as scratch:
        for number, choice in enumerate(CHOICES):
            folder = Path(scratch) / str(number)
            changed_sources(choice, folder)
            build(folder)
        for number, choice in enumerate(CHOICES):  # once all are built, so that the times lie close together
            built = ["--built", str(Path(scratch) / str(number)), "--choice", choice.name]
            subprocess.run([sys.executable, __file__, *arguments, *built], check=True)


if __name__ == "__main__":
    main(sys.argv[1:])
