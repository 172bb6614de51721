"""Adam as in Kingma and Ba's Algorithm 1, in plain torch."""

from __future__ import annotations

import torch


def steps(
    value: torch.Tensor,
    gradients: list[torch.Tensor],
    lr: torch.Tensor | float,
    betas: tuple[float, float] = (0.9, 0.999),
    epsilon: float = 1e-15,
) -> torch.Tensor:
    """Return the value after one step for each gradient."""
    first, second = torch.zeros_like(value), torch.zeros_like(value)
    for t, gradient in enumerate(gradients, 1):
        first = betas[0] * first + (1 - betas[0]) * gradient
        second = betas[1] * second + (1 - betas[1]) * gradient**2
        value = value - lr * (first / (1 - betas[0] ** t)) / ((second / (1 - betas[1] ** t)).sqrt() + epsilon)
    return value
