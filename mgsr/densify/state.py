"""The gradient statistics that densification gathers between its rounds; owned by the caller."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from mgsr.ops.statistics import gather_gradients


@dataclass
class DensifyState:
    """Sums since the last round, per splat: screen-space gradient lengths [N] and how often it was seen [N]."""

    gradient_sum: Tensor
    seen: Tensor

    @staticmethod
    def empty(count: int, device: torch.device | None = None) -> DensifyState:
        """Return a state in which nothing is gathered yet about `count` splats on `device`."""
        return DensifyState(torch.zeros(count, device=device), torch.zeros(count, device=device))

    def gather(
        self,
        v_means2d: Tensor,
        radii: Tensor,
        width: int,
        height: int,
        weight: float = 1.0,
        bad: Tensor | None = None,
    ) -> None:
        """Add one image's gradients.

        v_means2d [N,2]: the gradients of the loss by the projected centres, per pixel. They are converted to gradients
        per half image side, as in 3DGS, so that a threshold holds for images of any size.
        radii [N]: 0 for an invisible splat.
        weight: the branch's weight in the loss. It is divided out, so that the threshold has the same meaning in the
        warm-up and in the mutual phase.
        bad [] bool, on a GPU: whether to treat the gradients as zero.
        """
        scale = (0.5 * width / weight, 0.5 * height / weight)
        gather_gradients(self.gradient_sum, self.seen, v_means2d, radii, scale, bad)

    def to(self, device: torch.device) -> DensifyState:
        """Return the same state on a device."""
        return DensifyState(self.gradient_sum.to(device), self.seen.to(device))

    def mean_gradients(self) -> Tensor:
        """Return each splat's mean gradient length [N] over the images that saw it; 0 for one that none saw."""
        return self.gradient_sum / self.seen.clamp(min=1)

    def tensors(self) -> dict[str, Tensor]:
        """Return the tensors [N] by name for a checkpoint; `DensifyState(**tensors)` restores them."""
        return {"gradient_sum": self.gradient_sum, "seen": self.seen}
