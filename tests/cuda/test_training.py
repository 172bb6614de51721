"""Training with the CUDA kernels: the same loop, ending near where the processor's does."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import torch

from mgsr.errors import GpuError
from mgsr.gaussians.order import morton_order
from mgsr.training import trainer
from mgsr.training.branch import Branch
from mgsr.training.control import TrainingControl
from mgsr.training.run import Training
from tests.cuda.machines import GPU, SHIM, Machine, on_each_machine
from tests.optional import present
from tests.training.ball import ball_points, ball_scene
from tests.training.short_training import short, tensors

QUICK = ("warmup.surfel_iterations=3", "warmup.gaussian_iterations=3", "mutual.iterations=2", "sh_step=0.5")


@on_each_machine
def test_a_few_iterations_change_every_parameter(machine: Machine) -> None:
    scene, points = ball_scene(24, train=3, test=1), ball_points(80)
    with machine.running():
        result = Training(scene, points, short("mgsr", *QUICK), device=machine.device).run()
    reference = Training(scene, points, short("mgsr", *QUICK)).run()
    ours, theirs = tensors(result), tensors(reference)
    assert ours.keys() == theirs.keys()
    for name, tensor in ours.items():
        if name == "gaussians.quats":  # they start round, so that their rotation's gradient is rounding alone
            continue
        assert tensor.device.type == "cpu" and tensor.shape == theirs[name].shape, name
        # Adam's first steps go by the sign of a gradient: one that is rounding alone may go either way.
        assert ((tensor - theirs[name]).abs() < 1e-3).float().mean() > 0.99, name


@pytest.mark.slow
@on_each_machine
def test_training_ends_where_the_processor_does(machine: Machine) -> None:
    scene, points = ball_scene(32), ball_points(150)
    with machine.running():
        ours = Training(scene, points, short(), device=machine.device).run()
    theirs = Training(scene, points, short()).run()
    # dB; densification tips over on single splats.
    assert abs(present(ours.curve[-1].psnr) - present(theirs.curve[-1].psnr)) < 0.5
    assert ours.model.surfels is not None and theirs.model.surfels is not None
    assert abs(len(ours.model.surfels) - len(theirs.model.surfels)) < 0.05 * len(theirs.model.surfels)


def test_reordered_splats_are_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    """Check that reordering changes nothing.

    Only a GPU reorders; here the processor does too, at every densification.
    """
    reordered: list[int] = []
    adapt = Branch.adapt

    def adapt_and_reorder(branch: Branch[Any], grow: bool = True) -> None:
        adapt(branch, grow)
        before = {name: tensor.detach().clone() for name, tensor in branch.model.parameters().items()}
        branch.reorder()
        order = morton_order(before["means"])
        after = branch.model.parameters()
        assert all(
            torch.equal(after[name], tensor[order]) and after[name].requires_grad for name, tensor in before.items()
        )
        reordered.append(len(order))

    monkeypatch.setattr(Branch, "adapt", adapt_and_reorder)
    Training(ball_scene(24, train=3, test=1), ball_points(80), short("mgsr")).run()
    assert len(reordered) > 3


def test_a_checkpoint_serves_any_device(tmp_path: Path) -> None:
    """Check that restoring puts everything where the branch is.

    With a GPU, what the processor saved goes on there.
    """
    machine = GPU if torch.cuda.is_available() else SHIM
    scene, points, path = ball_scene(24, train=3, test=1), ball_points(80), tmp_path / "checkpoint.pt"
    Training(scene, points, short("2dgs", *QUICK), TrainingControl(checkpoint_path=path)).run()
    with machine.running():
        result = Training(
            scene, points, short("2dgs", *QUICK), TrainingControl(checkpoint_path=path, resume=True), machine.device
        ).run()
    assert result.model.surfels is not None


@pytest.mark.skipif(not hasattr(torch, "AcceleratorError"), reason="NEEDS TORCH 2.8: older ones have no such error")
def test_a_gpu_that_failed_is_told_with_the_cure(monkeypatch: pytest.MonkeyPatch) -> None:
    def failed(progress: object, bad: torch.Tensor | None = None) -> None:
        raise torch.AcceleratorError("CUDA error: an illegal memory access was encountered\nSearch for ...")

    monkeypatch.setattr(trainer, "step_trainables", failed)
    with pytest.raises(
        GpuError, match=r"the GPU failed \(CUDA error: an illegal memory access was encountered\), .*--resume"
    ):
        Training(ball_scene(24, train=3, test=1), ball_points(80), short("2dgs", *QUICK)).run()


def test_too_little_memory_is_refused_with_the_cure(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(progress: object, bad: torch.Tensor | None = None) -> None:
        raise torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 80.00 GiB")

    monkeypatch.setattr(trainer, "step_trainables", full)
    with pytest.raises(GpuError, match=r"80\.00 GiB.*max_side"):
        Training(ball_scene(24, train=3, test=1), ball_points(80), short("2dgs", *QUICK)).run()
