"""Time and error of the rasterizers with one choice of theirs made otherwise.

    python -m benchmarks.kernel_choices ../shared/data/raster [--keep benchmarks/results]

Each choice is a line of the C++ sources. It is changed in a copy of them, which is built beside and measured as
`kernels.py` does, on this processor's best vector variant; the choices take turns, each in a process of its own, so
that their ratio holds where the times drift. It takes some minutes, half of them the compiler's. With --keep the rows
become kernel_choices.csv.
"""

from __future__ import annotations

import argparse
import importlib.util
import multiprocessing
import shutil
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from benchmarks.evidence.kernels import AS_IT_IS, KernelRow, kernel_table, read_kernels, write_kernels
from benchmarks.evidence.kernels import CHOICES as CHOICES_FILE

ROOT = Path(__file__).parents[1]
RASTERIZERS = ("_gaussians", "_surfels")
COMMON = "mgsr/native/kernels/common/"
TILE = "constexpr int kTile = 16;"
TERMS = "kTerms[] = {9.6755410e-3f, 5.5507131e-2f, 2.4022120e-1f, 6.9314694e-1f, 1.0000001f};"
FIRST = "p[i] = splat(1.3276479e-3f);"
EXP2 = "  const vfloat shifter = splat(12582912.0f);"


@dataclass(frozen=True)
class Change:
    """A piece of a source file, and its replacement."""

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
    """Copy the native sources to `folder`, and make the choice there."""
    shutil.copytree(ROOT / "mgsr" / "native", folder / "mgsr" / "native", ignore=shutil.ignore_patterns("*.so"))
    shutil.copy(ROOT / "CMakeLists.txt", folder)
    for change in choice.changes:
        file = folder / change.file
        text = file.read_text()
        if text.count(change.old) != 1:
            raise SystemExit(f"{change.file}: expected {change.old!r} once, found it {text.count(change.old)} times")
        file.write_text(text.replace(change.old, change.new))


def build(folder: Path) -> None:
    """Build the rasterizers' modules, beside their sources."""
    tools = Path(sys.executable).parent
    options = ["-DCMAKE_BUILD_TYPE=Release", f"-DPython_EXECUTABLE={sys.executable}", "-DCMAKE_CXX_FLAGS=-w"]
    configure: list[str | Path] = [tools / "cmake", "-S", folder, "-B", folder / "build", *options]
    subprocess.run(configure, check=True, stdout=subprocess.DEVNULL)
    make: list[str | Path] = [tools / "cmake", "--build", folder / "build", "--parallel", "--target", *RASTERIZERS]
    subprocess.run(make, check=True, stdout=subprocess.DEVNULL)


def measure(choice: str, built: Path, scene: Path, runs: int, rows: Path) -> None:
    """Measure the rasterizers in `built`, and write the rows into the file `rows`.

    They take the place of the installed ones in this process.
    """
    for name in RASTERIZERS:
        file = next((built / "mgsr" / "native").glob(f"{name}.*.so"))
        spec = importlib.util.spec_from_file_location(f"mgsr.native.{name}", file)
        if spec is None or spec.loader is None:
            raise SystemExit(f"{file} cannot be loaded")
        if f"mgsr.native.{name}" in sys.modules:
            raise SystemExit(f"{name} is already loaded, so {file} would not be measured")
        module = importlib.util.module_from_spec(spec)
        sys.modules[f"mgsr.native.{name}"] = module
        spec.loader.exec_module(module)
    from benchmarks import kernels
    from mgsr.native import runtime

    runtime.set_threads(0)
    isa = runtime.isas()[0]
    found = [kernels.rows_of(case, [isa], runs, "")[0] for case in kernels.raster_cases(scene)]
    write_kernels(rows, [replace(row, variant=choice) for row in found])


def merged(rows: Sequence[KernelRow]) -> KernelRow:
    """Merge the rows of several processes for the same kernel and choice into one."""
    backward = [row.backward for row in rows if row.backward is not None]
    return replace(
        rows[0],
        forward=statistics.median(row.forward for row in rows),
        backward=statistics.median(backward) if backward else None,
        least=min(row.least for row in rows),
        cpu=statistics.median(row.cpu for row in rows),
    )


def main(arguments: Sequence[str]) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="the folder of the raster scenes")
    parser.add_argument("--scene", default="s20k_256")
    parser.add_argument("--rounds", type=int, default=7, help="the number of processes for each choice")
    parser.add_argument("--runs", type=int, default=5, help="the number of runs in each process")
    parser.add_argument("--keep", type=Path, help="a results folder")
    args = parser.parse_args(arguments)
    scene = args.folder / f"{args.scene}.npz"
    found: dict[tuple[str, str], list[KernelRow]] = {}
    with tempfile.TemporaryDirectory() as scratch:
        folders = [Path(scratch) / str(number) for number in range(len(CHOICES))]
        for choice, folder in zip(CHOICES, folders, strict=True):
            changed_sources(choice, folder)
            build(folder)
        for _ in range(args.rounds):
            for choice, folder in zip(CHOICES, folders, strict=True):
                context = multiprocessing.get_context("spawn")
                process = context.Process(
                    target=measure, args=(choice.name, folder, scene, args.runs, folder / "rows.csv")
                )
                process.start()
                process.join()
                if process.exitcode:
                    raise SystemExit(f"{choice.name}: the measuring process ended with {process.exitcode}")
                for row in read_kernels(folder / "rows.csv"):
                    found.setdefault((row.kernel, row.variant), []).append(row)
    rows = [merged(each) for each in found.values()]
    print(kernel_table(rows))
    if args.keep is not None:
        write_kernels(args.keep / CHOICES_FILE, rows)


if __name__ == "__main__":
    main(sys.argv[1:])
