"""All checks that only a GPU can do.

    scripts/gpu_check.sh [1|2|3] [FOLDER] [PACKED...]

Part 1: facts, the CPU kernels' build, the CUDA kernels' compilation, tests/cuda on the GPU, memcheck of three
families, and gsplat's build beside all that. Part 2: the benchmark, beside gsplat where that was built; the profile of
a training; ncu on single kernels. Part 3: whole trainings, memory, an illegal address. Without a number: all three.
Each part ends within 9 minutes, each step within a limit of its own; a step that fails does not stop the others; the
exit code is 0 where all went well.

FOLDER (out/gpu_check) gets at most eight files, none over 16 MB, which are only ever added to: summary.md, log.txt,
tests.txt, benchmark.md, profile.md, results.jsonl (every number) and splats.zip. PACKED are packed scenes and wheels,
or folders of such, as scripts/gpu_pack.sh makes one. What later parts use again is kept in WORK (build/gpu_check).

PYTHON names the interpreter, which must have torch for CUDA, numpy, SciPy, Pillow, pytest, cuda-core and an NVRTC;
the build takes cmake, ninja, nanobind and a C++ compiler. RUNS (20) is of the benchmark; SKIP, a list of steps, leaves
some out; LIMIT is a part's seconds (540); COMMIT is said where git can't tell it. To try the steps without a GPU:
DEVICE=cpu, and SETTINGS, a list of KEY=VALUE of every training, that make it short.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from benchmarks.gpu_check.results import Results
from benchmarks.gpu_check.runner import CutOffError, Place, run_part, say
from benchmarks.gpu_check.steps import PART_LIMIT, ROOT, parts
from benchmarks.gpu_check.wheels import find_wheel, unpack_wheel

# What shows that the interpreter has a package, by the package's name.
NEEDED = {"plyfile": "import plyfile", "cuda_core": "from cuda.core.utils import FileStreamProgramCache"}


def main(words: Sequence[str] | None = None) -> int:
    args = _arguments(list(sys.argv[1:] if words is None else words))
    place = Place(
        Results(args.folder),
        Path(os.environ.get("WORK", ROOT / "build" / "gpu_check")).resolve(),
        sys.executable,
        os.environ.get("DEVICE", "cuda"),
        tuple(path.resolve() for path in args.packed),
    )
    os.chdir(ROOT)
    place.work.mkdir(parents=True, exist_ok=True)
    bring_packages(place)
    limit, skip = float(os.environ.get("LIMIT", PART_LIMIT)), frozenset(os.environ.get("SKIP", "").split())
    good = True
    for number in args.parts:
        say(place.results, f"\n## Part {number}, {time.strftime('%F %T')}\n")
        try:
            good &= run_part(parts()[number], place, limit, skip)
        except CutOffError as cut:
            return cut.code
    return 0 if good else 1


def _arguments(words: list[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        "scripts/gpu_check.sh", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    chosen = [int(words.pop(0))] if words and words[0] in ("1", "2", "3") else [1, 2, 3]
    parser.add_argument("folder", type=Path, nargs="?", default=Path("out/gpu_check"))
    parser.add_argument("packed", type=Path, nargs="*")
    args = parser.parse_args(words)
    args.parts = chosen
    missing = [str(path) for path in args.packed if not path.exists()]
    if missing:
        parser.error(f"PACKED: there is no {', '.join(missing)}")
    return args


def bring_packages(place: Place) -> None:
    """Unpack the wheels of packages that the interpreter lacks, each into a folder that steps import from."""
    for name, statement in NEEDED.items():
        wheel, site = find_wheel(place.brought, name), place.work / f"site-{name}"
        if wheel is not None and not site.is_dir() and not _has(place.python, statement):
            unpack_wheel(wheel, site)
            say(place.results, f"- {name} is taken from {wheel.name}")


def _has(python: str, statement: str) -> bool:
    return subprocess.run([python, "-c", statement], capture_output=True, check=False).returncode == 0


if __name__ == "__main__":
    sys.exit(main())
