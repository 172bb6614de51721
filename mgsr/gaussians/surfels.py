"""The 2D branch's parameters: flat Gaussians (surfels) and their activations."""

from __future__ import annotations

from dataclasses import dataclass, fields

import torch
from torch import Tensor

from mgsr.checks import check_tensors
from mgsr.ops.activations import activate, shares
from mgsr.ops.harmonics import harmonics_to_rgb


@dataclass
class SurfelModel:
    """N surfels, as stored: float32, in the scene's frame.

    means [N,3]: the centres.
    quats [N,4]: wxyz, normalised when used. The columns of the rotation are the two tangents and the normal.
    log_scales [N,2]: along the tangents.
    opacity_logits [N].
    sh [N,K,3]: the colour coefficients.
    """

    means: Tensor
    quats: Tensor
    log_scales: Tensor
    opacity_logits: Tensor
    sh: Tensor

    def __len__(self) -> int:
        return self.means.shape[0]

    def parameters(self) -> dict[str, Tensor]:
        """Return the stored tensors [N,...] by name."""
        return {item.name: getattr(self, item.name) for item in fields(self)}

    def check(self) -> None:
        """Check that all tensors fit together; raise TensorError, which names the tensor, otherwise."""
        check_tensors(
            means=(self.means, "N 3"),
            quats=(self.quats, "N 4"),
            log_scales=(self.log_scales, "N 2"),
            opacity_logits=(self.opacity_logits, "N"),
            sh=(self.sh, "N K 3"),
        )

    @property
    def sh_degree(self) -> int:
        """Return the spherical-harmonic degree of the stored coefficients."""
        degree: int = round(self.sh.shape[1] ** 0.5) - 1
        return degree

    def scales(self) -> Tensor:
        """Return the standard deviations along the tangents, [N,2], in the scene's unit."""
        return activate(self.log_scales)[0]

    def opacities(self) -> Tensor:
        """Return the opacities [N], in (0, 1)."""
        return shares(self.opacity_logits)

    def colors(self, camera_center: Tensor, degree: int | None = None) -> Tensor:
        """Return the colours [N,3] seen from camera_center [3], with harmonics up to `degree`, or all of them."""
        return harmonics_to_rgb(self.sh, self.means, camera_center, self.sh_degree if degree is None else degree)

    def detached(self) -> SurfelModel:
        """Return a copy that carries no gradients."""
        return SurfelModel(**{name: tensor.detach().clone() for name, tensor in self.parameters().items()})

    def to(self, device: torch.device) -> SurfelModel:
        """Return the same model on a device (no copy where it already is)."""
        return SurfelModel(**{name: tensor.to(device) for name, tensor in self.parameters().items()})
