"""Densification statistics: the CUDA kernel against torch's operations."""

from __future__ import annotations

import torch

from mgsr.densify.state import DensifyState
from tests.cuda.machines import Machine, on_each_machine_and_order


@on_each_machine_and_order
def test_matches_torch(machine: Machine) -> None:
    generator = torch.Generator().manual_seed(0)
    ours, theirs = DensifyState.empty(600, machine.device), DensifyState.empty(600)
    for weight in (1.0, 0.5):
        gradients, radii = torch.randn(600, 2, generator=generator), torch.randn(600, generator=generator).clamp(min=0)
        theirs.gather(gradients, radii, 70, 50, weight)
        with machine.running():
            ours.gather(gradients.to(machine.device), radii.to(machine.device), 70, 50, weight)
    assert torch.equal(ours.seen.cpu(), theirs.seen)
    torch.testing.assert_close(ours.gradient_sum.cpu(), theirs.gradient_sum, rtol=1e-6, atol=0)
