"""Fused Adam's CUDA kernel against the algorithm in float64."""

from __future__ import annotations

import pytest
import torch

from mgsr.ops.adam import FusedAdam, any_bad, step_together
from tests.cuda.machines import Machine, on_each_machine, on_each_machine_and_order
from tests.ops.test_adam import BANDS, LRS, gradients, parameters
from tests.oracles import adam as oracle


def train(machine: Machine, n: int, steps: int) -> dict[str, torch.Tensor]:
    params = {name: p.detach().to(machine.device).requires_grad_() for name, p in parameters(n).items()}
    with machine.running():
        optimizer = FusedAdam(params, LRS, lr_scales={"sh": BANDS.to(machine.device)})
        for step in range(steps):
            for name, gradient in gradients(n, step).items():
                params[name].grad = gradient.to(machine.device)
            optimizer.step()
    return {name: p.detach().cpu() for name, p in params.items()}


@on_each_machine_and_order
@pytest.mark.parametrize("n", [1, 7, 111])
def test_matches_the_algorithm(machine: Machine, n: int) -> None:
    came = train(machine, n, 4)
    for name, p in parameters(n).items():
        lr = LRS[name] * (BANDS.double() if name == "sh" else 1.0)
        expected = oracle.steps(p.detach().double(), [gradients(n, step)[name].double() for step in range(4)], lr)
        # Four float32 steps of size lr on values of size 4: rounding of 2.4e-7 each.
        torch.testing.assert_close(came[name].double(), expected, rtol=0, atol=2e-6)


@on_each_machine
def test_more_parameters_than_a_launch_holds(machine: Machine) -> None:
    values = {f"p{i}": torch.ones(5, 2, device=machine.device).requires_grad_() for i in range(19)}
    with machine.running():
        optimizer = FusedAdam(values, dict.fromkeys(values, 0.5))
        for value in values.values():
            value.grad = torch.ones_like(value)
        optimizer.step()
    for value in values.values():  # the first step of Adam is the rate itself
        torch.testing.assert_close(value.detach().cpu(), torch.full((5, 2), 0.5))


@on_each_machine
@pytest.mark.parametrize("bad", [float("nan"), float("inf"), float("-inf"), 1e25])
def test_what_is_bad_is_seen(machine: Machine, bad: float) -> None:
    """Check that bad numbers are seen wherever they stand, also in the last block of the last tensor.

    Large numbers whose squares float32 holds are not bad.
    """
    sizes = (1, 1024, 2500)
    good = [torch.full((size,), 1e15, device=machine.device) for size in sizes]
    with machine.running():
        assert not bool(any_bad(good))
        for tensor in good:
            for place in (0, -1):
                tensor[place] = bad
                assert bool(any_bad(good))
                tensor[place] = 1.0


@on_each_machine
def test_bad_gradients_count_as_zero(machine: Machine) -> None:
    """Check that bad gradients act as a step along zeros: momentum goes on, and nothing turns bad."""
    params = {
        name: [p.detach().to(machine.device).requires_grad_() for _ in range(2)] for name, p in parameters(7).items()
    }
    with machine.running():
        optimizers = [FusedAdam({name: pair[i] for name, pair in params.items()}, LRS) for i in range(2)]
        for step in range(2):
            for name, pair in params.items():
                for i, param in enumerate(pair):
                    later = torch.full_like(param, float("nan")) if i == 0 else torch.zeros_like(param)
                    param.grad = later if step else gradients(7, 0)[name].to(machine.device)
            for i, optimizer in enumerate(optimizers):
                step_together([optimizer], torch.tensor(bool(step) and i == 0, device=machine.device))
    for bad, zero in params.values():
        assert torch.equal(bad.detach(), zero.detach())
