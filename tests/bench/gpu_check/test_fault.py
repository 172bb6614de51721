"""What a person sees when a GPU's kernels go wrong, with an error in the GPU's place."""

from __future__ import annotations

import sys

import pytest
import typer

from benchmarks.gpu_check import fault
from mgsr.errors import GpuError


def test_a_refusal_is_one_message(capsys: pytest.CaptureFixture[str]) -> None:
    def go_wrong() -> None:
        raise GpuError("gaussians_blend_single failed on GPU 0: CUDA_ERROR_ILLEGAL_ADDRESS; start anew")

    with pytest.raises(typer.Exit) as ended:
        fault.train_and_break("cpu", go_wrong)
    seen = capsys.readouterr().err
    assert fault.judge(ended.value.exit_code, seen) is None
    assert seen == "error: gaussians_blend_single failed on GPU 0: CUDA_ERROR_ILLEGAL_ADDRESS; start anew\n"


def test_a_traceback_is_none() -> None:
    assert "exit code 1 and 2 lines" in str(fault.judge(1, "Traceback (most recent call last):\nRuntimeError"))
    assert "exit code 2 and 2 lines" in str(fault.judge(2, "Traceback (most recent call last):\nRuntimeError"))
    assert fault.judge(-11, "") is not None and fault.judge(0, "") is not None
    assert fault.judge(None, "") is not None


def test_a_training_that_hangs_is_ended_and_what_it_said_is_kept() -> None:
    program = "import sys, time; print('said', file=sys.stderr, flush=True); time.sleep(1000)"
    assert fault.ended([sys.executable, "-c", program], limit=2.0) == (None, "said\n")
    assert fault.ended([sys.executable, "-c", "raise SystemExit(2)"]) == (2, "")
