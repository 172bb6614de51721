"""From stored to linear scales, of both branches."""

from __future__ import annotations

from torch import Tensor

# exp of more comes near float32's largest number, and an infinite scale would make its own zero gradient a NaN.
LARGEST_LOG_SCALE = 80.0


def linear_scales(log_scales: Tensor) -> Tensor:
    """exp of log-scales of any shape; constant, and without a gradient, over 80."""
    return log_scales.clamp(max=LARGEST_LOG_SCALE).exp()
