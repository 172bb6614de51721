"""A run of fifty thousand iterations on a tiny scene, to see whether memory or anything else drifts.

    PYTHONPATH=. python benchmarks/long_run.py --keep benchmarks/results/long_run.csv

Fifty looks, each a row as `tests/stability/long_training.py` defines it, then the growth of memory in each stage.
"""

from __future__ import annotations

import argparse
import csv
import sys
import time
from dataclasses import asdict, fields
from pathlib import Path

from mgsr.native import runtime
from tests.stability.long_training import Look, growth, long_training


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--iterations", type=int, default=50_000)
    parser.add_argument("--side", type=int, default=32, help="the side of the views, in pixels")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--keep", type=Path, help="the table to write")
    args = parser.parse_args()
    runtime.set_threads(args.threads)
    started_at, names = time.process_time(), [field.name for field in fields(Look)]
    with sys.stdout if args.keep is None else args.keep.open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(names)

        def write(look: Look) -> None:
            table.writerow(f"{value:.5g}" if isinstance(value, float) else value for value in asdict(look).values())
            file.flush()

        slopes = growth(long_training(args.iterations, write, args.side))
    for stage, slope in slopes.items():
        print(f"{stage}: {slope:+.2f} MiB per 10,000 iterations", file=sys.stderr)
    print(f"{time.process_time() - started_at:.0f} s of processor time", file=sys.stderr)


if __name__ == "__main__":
    main()
