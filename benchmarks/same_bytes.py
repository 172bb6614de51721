"""Whether two checkouts of MGSR make the same files, byte for byte: the check of a change that must change no result.

    python -m benchmarks.same_bytes BEFORE AFTER [SCENE ...] -o OUT [--example] [--preset draft] [--set KEY=VALUE ...]
    python -m benchmarks.same_bytes RUN RUN

BEFORE, AFTER: checkouts whose kernels are built. Each reconstructs every SCENE, on the CPU with one seed, into
OUT/before and OUT/after; `--example` adds the example capture of BEFORE. Without `-o`, the two folders are results that
are there already. A line a scene says how many files are equal, or which differ. The exit code is 1 if any does.

Logs, reports and checkpoints hold times. log.txt, report.html and checkpoint are therefore left out, and of report.json
what differs between two equal runs. Settings that only one checkout has are named, but do not count as a difference.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

EXAMPLE = Path("examples/glossy_knot")
REPORT = "report.json"
LEFT_OUT = ("log.txt", "report.html", "checkpoint")
# Parts of report.json that differ between two equal runs. The decisions are prose on the other parts.
VOLATILE = ("command", "decisions", "machine", "peak_memory_mib", "seconds", "versions")
SETTINGS = "settings"
# The command `mgsr` of a checkout. The finder of an editable installation would import the installed checkout instead.
PROGRAM = """
import runpy, sys
from pathlib import Path
checkout = sys.argv.pop(1)
sys.path.insert(0, checkout)
sys.meta_path[:] = [finder for finder in sys.meta_path if getattr(finder, "__module__", "").startswith("_frozen")]
import mgsr
assert Path(mgsr.__file__).is_relative_to(checkout), mgsr.__file__
runpy.run_module("mgsr.cli.main", run_name="__main__", alter_sys=True)
"""
ALONE = "(one side alone)"


@dataclass(frozen=True)
class Comparison:
    """The comparison of two folders of results.

    equal: the number of equal files. differences: the files that only one folder has or that differ, and the parts of
    report.json that do. new_settings: settings that only one report has.
    """

    equal: int
    differences: tuple[str, ...]
    new_settings: tuple[str, ...]

    @property
    def text(self) -> str:
        """Return the comparison in one line."""
        found = f"{self.equal} files are equal"
        if self.differences:
            found = f"{found}; these differ: {', '.join(self.differences)}"
        if self.new_settings:
            found += f"; one side alone has {len(self.new_settings)} settings, such as {self.new_settings[0]}"
        return found


def compare_results(before: Path, after: Path) -> Comparison:
    """Compare two folders of results file by file. Raises ValueError where a folder holds no finished run."""
    for folder in (before, after):
        if not (folder / REPORT).is_file():
            raise ValueError(f"{folder}: expected the results of a finished run, found no {REPORT}")
    names = [set(_files(folder)) for folder in (before, after)]
    differences = [f"{name} {ALONE}" for name in sorted(names[0] ^ names[1])]
    common = sorted((names[0] & names[1]) - {REPORT})
    unequal = [name for name in common if (before / name).read_bytes() != (after / name).read_bytes()]
    reports = [json.loads((folder / REPORT).read_text(encoding="utf-8")) for folder in (before, after)]
    parts = set(_unequal_parts(*reports))
    new_settings = {part for part in parts if part.startswith(f"{SETTINGS}.") and part.endswith(ALONE)}
    in_report = [f"{REPORT}: {part}" for part in sorted(parts - new_settings)]
    equal = len(common) - len(unequal) + (not in_report)
    return Comparison(equal, (*differences, *unequal, *in_report), tuple(sorted(new_settings)))


def _files(folder: Path) -> Iterator[str]:
    """Yield the names, relative to a folder, of the files in it that are compared."""
    for path in folder.rglob("*"):
        if path.is_file() and path.name not in LEFT_OUT:
            yield str(path.relative_to(folder))


def _unequal_parts(before: Any, after: Any, path: str = "") -> Iterator[str]:
    """Yield the dotted paths at which two JSON values differ, without what is volatile."""
    if isinstance(before, dict) and isinstance(after, dict):
        for name in sorted(before.keys() | after.keys()):
            inner = f"{path}.{name}" if path else name
            if name in VOLATILE:
                continue
            if name in before and name in after:
                yield from _unequal_parts(before[name], after[name], inner)
            else:
                yield f"{inner} {ALONE}"
    elif isinstance(before, list) and isinstance(after, list) and len(before) == len(after):
        for index, (one, other) in enumerate(zip(before, after, strict=True)):
            yield from _unequal_parts(one, other, f"{path}.{index}")
    elif before != after:
        yield path


def reconstruct(checkout: Path, scene: Path, out: Path, options: Sequence[str]) -> None:
    """Run `mgsr run` of a checkout on a scene. Raises subprocess.CalledProcessError where the run fails."""
    words = ["run", str(scene.resolve()), "-o", str(out.resolve()), *options]
    command = [sys.executable, "-c", PROGRAM, str(checkout.resolve()), *words]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)


def main() -> None:
    given = arguments()
    compared = [_told("results", (given.before, given.after))] if given.out is None else list(_compared_runs(given))
    sys.exit(1 if any(comparison.differences for comparison in compared) else 0)


def _told(name: str, folders: Sequence[Path]) -> Comparison:
    """Compare two folders of results, and print a line on them."""
    comparison = compare_results(*folders)
    print(f"{name}: {comparison.text}", flush=True)
    return comparison


def _compared_runs(given: argparse.Namespace) -> Iterator[Comparison]:
    """Run both checkouts on each scene, and print and yield the comparisons."""
    options = ["--preset", given.preset, "--device", "cpu", "--seed", str(given.seed)]
    options += [word for setting in given.settings for word in ("--set", setting)]
    for scene in [*given.scenes, *([given.before / EXAMPLE] if given.example else [])]:
        folders = [given.out / side / scene.name for side in ("before", "after")]
        for checkout, folder in zip((given.before, given.after), folders, strict=True):
            reconstruct(checkout, scene, folder, options)
        yield _told(scene.name, folders)


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("before", type=Path)
    parser.add_argument("after", type=Path)
    parser.add_argument("scenes", type=Path, nargs="*")
    parser.add_argument("-o", dest="out", type=Path)
    parser.add_argument("--example", action="store_true")
    parser.add_argument("--preset", default="draft")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--set", dest="settings", metavar="KEY=VALUE", action="append", default=[])
    given = parser.parse_intermixed_args()
    if (given.out is None) == bool(given.scenes or given.example):
        parser.error("expected two checkouts with -o OUT and a SCENE or --example, or two folders of results alone")
    return given


if __name__ == "__main__":
    main()
