"""Write docs/evidence.md and its plots.

python -m benchmarks.evidence [benchmarks/results] [docs]
"""

from __future__ import annotations

import argparse
from pathlib import Path

from benchmarks.evidence.page import write_evidence

parser = argparse.ArgumentParser(prog="python -m benchmarks.evidence", description="Write docs/evidence.md.")
parser.add_argument(
    "results", type=Path, nargs="?", default=Path("benchmarks/results"), help="the folder of the results"
)
parser.add_argument("docs", type=Path, nargs="?", default=Path("docs"), help="the folder for the page and the images")
args = parser.parse_args()
print(write_evidence(args.results, args.docs))
