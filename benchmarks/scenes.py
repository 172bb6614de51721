"""Speed against error on whole scenes:

    python benchmarks/scenes.py ../shared/data/scenes bunny_flash spot_soft --presets draft standard --methods mgsr \\
        --out out/bench --evaluate ../shared/tools/evaluate.py --table benchmarks/results/scenes.md

Each scene, preset and method is one `mgsr-worker run` in a process of its own; a run whose report.json exists is not
made again. With --evaluate the figures are the reference evaluator's, otherwise the report's own. Chamfer is in
thousandths of the object's radius, F at 0.5%, normal consistency times 100.
"""

from __future__ import annotations

import argparse
import json
import platform
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Run:
    """One cell of the matrix."""

    scene: Path
    preset: str
    method: str
    settings: tuple[str, ...]
    out: Path

    def make(self) -> None:
        """Reconstruct, unless it was done before."""
        if (self.out / "report.json").exists():
            return
        command = [sys.executable, "-m", "worker.cli", "run", str(self.scene), "-o", str(self.out)]
        command += ["--preset", self.preset, "--method", self.method]
        for setting in self.settings:
            command += ["--set", setting]
        self.out.mkdir(parents=True, exist_ok=True)
        self._commit_file.write_text(commit())
        subprocess.run(command, check=True)

    @property
    def commit(self) -> str:
        """The commit that the run was made at."""
        return self._commit_file.read_text()

    @property
    def _commit_file(self) -> Path:
        return self.out / "commit.txt"

    def evaluate(self, evaluator: Path) -> dict[str, float]:
        """The reference evaluator's figures, kept beside the run."""
        kept = self.out / "evaluate.json"
        if not kept.exists():
            command = [sys.executable, str(evaluator), str(self.scene), "--mesh", str(self.out / "mesh.ply")]
            command += ["--renders", str(self.out / "renders" / "test")]
            kept.write_text(subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()[-1])
        return json.loads(kept.read_text())


COLUMNS = (
    "scene preset method seconds PSNR PSNR-object SSIM Chamfer F NC normal-error split-gain surfels volumes faces MiB "
    "commit"
)


def commit() -> str:
    """The working tree's commit, with a plus if the program was changed since."""
    asked = ["git", "rev-parse", "--short", "HEAD"], ["git", "status", "--porcelain", "--", "mgsr", "worker"]
    name, changes = (subprocess.run(command, capture_output=True, text=True).stdout.strip() for command in asked)
    return name + ("+" if changes else "")


def row(run: Run, evaluator: Path) -> list[str]:
    """One line of the table."""
    report: dict[str, Any] = json.loads((run.out / "report.json").read_text())
    figures = run.evaluate(evaluator)
    counts = report["gaussians"]
    method = run.method + "".join(f" {setting}" for setting in run.settings)
    cells = [run.scene.name, run.preset, method, f"{report['seconds']['total']:.0f}"]
    cells += [f"{figures['psnr']:.2f}", f"{figures['psnr_fg']:.2f}", f"{figures['ssim']:.4f}"]
    cells += [f"{1000 * figures['chamfer']:.2f}", f"{figures['F@0.005']:.3f}"]
    cells += [f"{100 * figures['normal_consistency']:.2f}", f"{figures['normal_mae_deg']:.2f}"]
    cells += [f"{figures['split_gain']:.2f}" if "split_gain" in figures else "-"]
    cells += [str(counts.get("surfels", 0)), str(counts.get("volumes", 0)), str(report["mesh"]["faces"])]
    return [*cells, f"{report['peak_memory_mib']:.0f}", run.commit]


def table(rows: list[list[str]]) -> str:
    """Markdown, with what it was made by."""
    head = COLUMNS.split()
    lines = ["| " + " | ".join(cells) + " |" for cells in (head, ["---"] * len(head), *rows)]
    machine = f"{platform.processor() or platform.machine()}, Python {platform.python_version()}"
    made_by = f"`python {' '.join(sys.argv)}`, {machine}"
    return "\n".join([made_by, "", *lines, ""])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("scenes", nargs="+")
    parser.add_argument("--presets", nargs="+", default=["standard"])
    parser.add_argument("--methods", nargs="+", default=["mgsr"])
    parser.add_argument("--set", action="append", default=[], dest="settings", metavar="KEY=VALUE")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--evaluate", type=Path, required=True)
    parser.add_argument("--table", type=Path)
    args = parser.parse_args()
    rows = []
    for preset in args.presets:
        for method in args.methods:
            for scene in args.scenes:
                name = "-".join([scene, preset, method, *args.settings]).replace("=", "_")
                run = Run(args.folder / scene, preset, method, tuple(args.settings), args.out / name)
                run.make()
                rows.append(row(run, args.evaluate))
                if args.table:
                    args.table.write_text(table(rows))
    print(table(rows))


if __name__ == "__main__":
    main()
