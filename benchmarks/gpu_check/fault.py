"""Check of what a person sees after an illegal address: a training on the GPU, whose kernels go wrong in its midst.

A process of its own trains the ball, as `mgsr train` would tell of it, and launches a kernel of ours on addresses that
are nobody's. It should end with one message that says what to do, and exit code 2, as after all that is refused.
"""

from __future__ import annotations

import ctypes
import subprocess
import sys
from collections.abc import Callable

import torch
import typer

from benchmarks.gpu_check.arguments import parser, require_gpu, results_of
from benchmarks.gpu_check.results import tell
from benchmarks.packed_scenes import ball
from mgsr.cli.options import REFUSED, refusals
from mgsr.config import make_config
from mgsr.native.cuda.launcher import cuda_launcher
from mgsr.training.control import TrainingControl
from mgsr.training.run import Training

KERNEL = ("gaussians", "gaussians_project")
NOBODYS = 0x4000  # an address that is mapped nowhere, and as a count of splats enough for some threads to read it
GOOD_ITERATIONS = 20
LIMIT = 50.0  # seconds


def train_and_break(device: str, go_wrong: Callable[[], None]) -> None:
    """Train the ball as the command line does; before an iteration, `go_wrong` is called."""
    done = 0

    def should_stop() -> bool:
        nonlocal done
        done += 1
        if done == GOOD_ITERATIONS:
            go_wrong()
        return False

    with refusals():
        scene, start = ball(size=96, train=8, points=1000)
        config = make_config("draft")
        Training(scene, start, config, TrainingControl(should_stop=should_stop), torch.device(device)).run()


def read_nobodys_memory() -> None:
    """Launch a kernel whose every pointer, and count, is NOBODYS."""
    words = ctypes.c_int64 * 512

    class Nonsense(ctypes.Structure):
        _fields_ = (("words", words),)

    params = Nonsense(words(*[NOBODYS] * 512))
    cuda_launcher(torch.cuda.current_device()).launch(*KERNEL, 1, 128, params)


def judge(code: int | None, error: str) -> str | None:
    """Return what is wrong with what a person saw; None where nothing is. code: None where the process did not end."""
    if code is None:
        return "the training did not end by itself"
    if code == 0:
        return "the training ended without an error"
    if "Traceback" in error or code != REFUSED:
        return f"exit code {code} and {len(error.splitlines())} lines, expected exit code {REFUSED} and a message"
    return None


def main() -> None:
    made = parser(__doc__)
    made.add_argument("--child", action="store_true")
    args = made.parse_args()
    require_gpu(args.device)
    if args.child:
        app = typer.Typer(pretty_exceptions_enable=False)
        app.command()(lambda: train_and_break(args.device, read_nobodys_memory))
        app([])
    words = [sys.executable, "-m", "benchmarks.gpu_check.fault", "--child"]
    words += ["--results", str(args.results), "--work", str(args.work), "--device", args.device]
    code, error = ended(words)
    print(f"exit code {code}\n{error}", flush=True)
    results_of(args).row(step="illegal-address", code=code, error=error[-4000:])
    seen = [line for line in error.splitlines() if line.strip()] or ["nothing"]
    tell(f"the user sees ({len(seen)} lines): {seen[-1][:300]}")
    wrong = judge(code, error)
    if wrong is not None:
        raise SystemExit(wrong)


def ended(words: list[str], limit: float = LIMIT) -> tuple[int | None, str]:
    """Return a process's exit code, and what it said on stderr.

    The exit code is None where the process had to be killed after so many seconds.
    """
    process = subprocess.Popen(words, stderr=subprocess.PIPE, text=True, errors="replace")
    try:
        _, error = process.communicate(timeout=limit)
    except subprocess.TimeoutExpired:
        process.kill()
        return None, process.communicate()[1]
    return process.returncode, error


if __name__ == "__main__":
    main()
