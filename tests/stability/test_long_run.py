"""Fifty thousand iterations on a tiny scene: memory and invariants do not drift."""

from __future__ import annotations

import resource

import pytest
import torch

from mgsr.config import make_config
from mgsr.training.progress import Progress, TrainResult
from mgsr.training.run import train
from tests.training.ball import ball_points, ball_scene
from tests.training.test_train import tensors

ITERATIONS = 50_000


def long_training(iterations: int) -> tuple[TrainResult, list[int], list[Progress]]:
    """The result, the process's largest memory in KiB at each report, and the reports."""
    warmup, mutual = 2 * iterations // 5, iterations // 5
    overrides = [f"warmup.surfel_iterations={warmup}", f"warmup.volume_iterations={warmup}"]
    overrides += [f"mutual.iterations={mutual}", "stop_rule=none", "curve_views=1"]
    overrides += [f"curve_every={iterations // 50}", f"report_every={iterations // 50}"]
    overrides += [f"{branch}.densify.max_count=150" for branch in ("surfels", "volumes")]
    memory: list[int] = []
    reports: list[Progress] = []

    def look(report: Progress) -> None:
        memory.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
        reports.append(report)

    config = make_config("draft", "mgsr", 0, overrides)
    return train(ball_scene(16, train=6, test=1), ball_points(100), config, look), memory, reports


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_nothing_drifts_in_fifty_thousand_iterations() -> None:
    result, memory, reports = long_training(ITERATIONS)
    assert sum(stage.iterations for stage in result.stages) == ITERATIONS
    assert result.incidents == []
    for name, tensor in tensors(result).items():
        assert torch.isfinite(tensor).all(), name
        assert tensor.abs().max() < 1e4, name
    # The mutual phase is the last fifth, and holds all that there is: soon after its begin memory stands still.
    settled = memory[len(memory) * 42 // 50]
    assert memory[len(memory) * 38 // 50] - memory[len(memory) * 2 // 50] < 16 * 1024
    assert memory[-1] - settled < 16 * 1024, f"grew by {(memory[-1] - settled) / 1024:.0f} MiB"
    assert all(0 < count <= 300 for report in reports for count in report.counts.values())
    psnrs = [row.psnr for row in result.curve if row.stage == "mutual" and row.psnr is not None]
    assert min(psnrs[1:]) > max(psnrs) - 6
