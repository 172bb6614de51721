"""What densification remembers between its rounds; owned by the caller."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass
class DensifyState:
    """Sums since the last round, per splat: screen-space gradient lengths [N] and how often it was seen [N]."""

    gradient_sum: Tensor
    seen: Tensor

    @staticmethod
    def empty(count: int) -> DensifyState:
        """Nothing gathered yet about `count` splats."""
        return DensifyState(torch.zeros(count), torch.zeros(count))

    def gather(self, v_means2d: Tensor, visible: Tensor, width: int, height: int, weight: float = 1.0) -> None:
        """Add one image's gradients.

        v_means2d [N,2]: of the loss, per pixel of the projected centres; counted per half image side as 3DGS does,
        so that a threshold holds for images of any size. visible [N] bool. weight: the branch's weight in the loss,
        divided out so that the threshold means the same alone and in the mutual phase.
        """
        scale = v_means2d.new_tensor([0.5 * width / weight, 0.5 * height / weight])
        self.gradient_sum += torch.linalg.vector_norm(v_means2d * scale, dim=1)
        self.seen += visible

    def mean_gradients(self) -> Tensor:
        """The mean over the images that saw each splat, [N]; 0 for one that none saw."""
        return self.gradient_sum / self.seen.clamp(min=1)

    def tensors(self) -> dict[str, Tensor]:
        """For a checkpoint; `DensifyState(**tensors)` takes them back."""
        return {"gradient_sum": self.gradient_sum, "seen": self.seen}
