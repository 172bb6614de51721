"""Train a packed scene on the GPU, or the tests' ball; its numbers go into results.jsonl.

--bring-home: its splats go into splats.zip, too. --same-as STEP: what was learnt is compared, byte for byte, with what
the step of that name learnt.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch

from benchmarks.cuda_training import LEARNT, digests, run
from benchmarks.gpu_check.arguments import parser, require_gpu, results_of, work_of
from benchmarks.gpu_check.results import Results, tell
from benchmarks.packed_scenes import FINDINGS, packed_or_ball
from mgsr.config import make_config


def main() -> None:
    made = parser(__doc__)
    made.add_argument("scene", help="a packed scene, or `ball`")
    made.add_argument("--step", required=True)
    made.add_argument("--preset", default="standard")
    made.add_argument("--set", dest="settings", action="append", default=[], metavar="KEY=VALUE")
    made.add_argument("--deadline", type=float, required=True, metavar="SECONDS")
    made.add_argument("--bring-home", action="store_true")
    made.add_argument("--same-as", metavar="STEP")
    args = made.parse_args()
    require_gpu(args.device)
    results, out = results_of(args), work_of(args) / "trained" / args.step
    config = make_config(args.preset, overrides=args.settings)
    facts = run(packed_or_ball(args.scene, config), out, config, torch.device(args.device), args.deadline)
    results.row(step=args.step, settings=args.settings, **facts)
    tell(line(facts))
    if args.bring_home:
        bring_home(results, Path(args.scene).stem, out)
    if args.same_as is not None:
        compare(facts, results.rows(args.same_as), args.same_as)


def line(facts: dict[str, Any]) -> str:
    """Return one line that sums up a training."""
    psnr = ", ".join(f"{name} {value:.2f} dB" for name, value in facts["psnr"].items())
    counts = ", ".join(f"{count} {name}" for name, count in facts["splats"].items())
    stopped = "" if finished(facts) else "; ENDED BY ITS LIMIT OF TIME"
    return f"{facts['scene']} {facts['preset']}: {facts['seconds']:.1f} s, {psnr}, {counts}{stopped}"


def finished(facts: dict[str, Any]) -> bool:
    """Return whether no stage was ended by the deadline."""
    return all(reason != "deadline" for _, _, reason in facts["stages"].values())


def compare(facts: dict[str, Any], others: list[dict[str, Any]], name: str) -> None:
    """Print whether what was learnt is the same as in an earlier training.

    Raises SystemExit where it is not, or nothing can be said.
    """
    if not others:
        raise SystemExit(f"{name} has no row to compare with")
    other = others[-1]
    if not (finished(facts) and finished(other)):
        raise SystemExit("not compared, because a training stopped by its time limit ends elsewhere each time")
    differing = [name for name in LEARNT if facts["sha256"].get(name) != other["sha256"].get(name)]
    if differing:
        raise SystemExit(f"NOT the same bytes as {name}: {', '.join(differing)}")
    tell(f"the same bytes as {name}: {', '.join(sorted(facts['sha256']))}")


def bring_home(results: Results, scene: str, out: Path) -> None:
    """Put into splats.zip what `mgsr mesh` and `mgsr evaluate` need."""
    files = [out / name for name in (*LEARNT, *FINDINGS, "training.json") if (out / name).is_file()]
    size = results.keep_splats(scene, files)
    if size:
        tell(f"its splats are in splats.zip, {size / 2**20:.1f} MiB")
    else:
        tell(f"its splats are NOT in splats.zip, which they would make too large; sha256 {digests(out)}")


if __name__ == "__main__":
    main()
