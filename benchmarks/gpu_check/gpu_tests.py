"""Run pytest where there is a GPU, and count its outcomes: without one, tests are skipped, and nothing is shown."""

from __future__ import annotations

import argparse
from collections import Counter

import pytest

from benchmarks.gpu_check.arguments import require_gpu
from benchmarks.gpu_check.results import tell


class Outcomes:
    """A plugin that counts passed, failed and skipped tests."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.when == "call" or report.outcome != "passed":
            self.counts[report.outcome] += 1


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", default="cuda", help="cpu runs the tests without a GPU")
    parser.add_argument("words", nargs="+", help="arguments for pytest, after --")
    args = parser.parse_args()
    require_gpu(args.device)
    outcomes = Outcomes()
    # -vv: a line for each test as it ends, so that a run which is cut off tells how far it came.
    code = pytest.main(["-vv", "-p", "no:cacheprovider", *args.words], plugins=[outcomes])
    tell(", ".join(f"{count} {outcome}" for outcome, count in outcomes.counts.items()) or "no test was run")
    raise SystemExit(int(code) or int(not outcomes.counts["passed"]))


if __name__ == "__main__":
    main()
