"""Quality over time: runs of growing time budgets, by two programs in turns.

    python -m benchmarks.quality_over_time SCENE... --before COMMIT=COMMAND --after COMMIT=COMMAND --runs FOLDER
        [-o benchmarks/results/quality_over_time.csv] [--budgets 15 30 60 120]

COMMAND is the `mgsr` of a program, such as `.venv/bin/mgsr` of a checkout at COMMIT. For each scene and each budget,
the programs run one after the other, so that both meet the same machine. ../shared/tools/evaluate.py scores the
results. Finished runs in FOLDER are not repeated; rows of other scenes and budgets stay in the file.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import time
from pathlib import Path

from benchmarks.evidence.quality_over_time import QUALITY, Program, QualityRow
from benchmarks.render_scenes import SHARED
from mgsr.bench.csv_rows import read_csv, write_csv
from mgsr.bench.scores import evaluator_scores

RESULTS = Path(__file__).parent / "results" / QUALITY
SECONDS = "seconds.json"


def main() -> None:
    given = arguments()
    programs = {Program.BEFORE: given.before, Program.AFTER: given.after}
    for scene in given.scenes:
        for budget in given.budgets:
            for program, (commit, command) in programs.items():
                out = given.runs / f"{scene.name}-{budget:g}-{commit}"
                if not (out / SECONDS).is_file():
                    run(command, scene, budget, out)
                row = QualityRow(scene.name, budget, program, commit, *scored(scene, out, given.evaluate))
                print(row, flush=True)
                others = [old for old in read_csv(given.out, QualityRow) if old.cell != row.cell]
                rows = sorted([*others, row], key=lambda each: each.cell)
                write_csv(given.out, QualityRow, rows, digits=5)


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="+", type=Path)
    parser.add_argument("-o", dest="out", type=Path, default=RESULTS)
    parser.add_argument("--before", type=named, required=True, metavar="COMMIT=COMMAND")
    parser.add_argument("--after", type=named, required=True, metavar="COMMIT=COMMAND")
    parser.add_argument("--runs", type=Path, required=True)
    parser.add_argument("--budgets", nargs="+", type=float, default=[15, 30, 60, 120], help="seconds")
    parser.add_argument("--evaluate", type=Path, default=SHARED / "tools" / "evaluate.py")
    return parser.parse_args()


def named(word: str) -> tuple[str, str]:
    """Split COMMIT=COMMAND.

    Raises ArgumentTypeError for any other form.
    """
    commit, equals, command = word.partition("=")
    if not (commit and equals and command):
        raise argparse.ArgumentTypeError(f"expected COMMIT=COMMAND, but got {word!r}")
    return commit, command


def run(command: str, scene: Path, budget: float, out: Path) -> None:
    """Run a program's `mgsr run` into `out`, and keep the seconds that the whole command took."""
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    words = [command, "run", str(scene.resolve()), "-o", str(out.resolve()), "--time-budget", f"{budget:g}"]
    begun = time.monotonic()
    with open(out / "console.txt", "w", encoding="utf-8") as console:
        subprocess.run(words, check=True, stdout=console, stderr=subprocess.STDOUT)
    (out / SECONDS).write_text(json.dumps(time.monotonic() - begun))


def scored(scene: Path, out: Path, evaluator: Path) -> tuple[float, float, float]:
    """Return the seconds, the PSNR and the Chamfer distance of a finished run."""
    scores = evaluator_scores(evaluator, scene, out)
    psnr, chamfer = scores["psnr"], scores["chamfer"]
    if psnr is None or chamfer is None:
        raise SystemExit(f"{out}: expected PSNR and Chamfer from {evaluator}, but got {scores}")
    return json.loads((out / SECONDS).read_text()), psnr, chamfer


if __name__ == "__main__":
    main()
