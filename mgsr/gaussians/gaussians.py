"""The 3D branch's parameters: Gaussians with a transmitted and, optionally, a reflected half."""

from __future__ import annotations

from dataclasses import dataclass, field, fields

import torch
from torch import Tensor

from mgsr.checks import check_tensors
from mgsr.ops.activations import activate, shares
from mgsr.ops.harmonics import harmonics_to_rgb


@dataclass
class GaussianModel:
    """N Gaussians, as stored: float32, in the scene's frame.

    means [N,3]: the centres.
    quats [N,4]: wxyz, normalised when used.
    log_scales [N,3].
    opacity_logits [N], sh [N,K,3]: the opacity and the coefficients of the transmitted colour.
    refl_opacity_logits [N], weight_logits [N], refl_sh [N,K',3]: the opacity of the reflected colour, its weight beta,
    and its coefficients; all None without the light split.
    low_pass: px^2, added to the variance of each footprint in an image, in training as in rendering.
    """

    means: Tensor
    quats: Tensor
    log_scales: Tensor
    opacity_logits: Tensor
    sh: Tensor
    refl_opacity_logits: Tensor | None = None
    weight_logits: Tensor | None = None
    refl_sh: Tensor | None = None
    low_pass: float = field(kw_only=True)

    def __len__(self) -> int:
        return self.means.shape[0]

    def check(self) -> None:
        """Check that all tensors fit together; raise TensorError, which names the tensor, otherwise."""
        check_tensors(
            means=(self.means, "N 3"),
            quats=(self.quats, "N 4"),
            log_scales=(self.log_scales, "N 3"),
            opacity_logits=(self.opacity_logits, "N"),
            sh=(self.sh, "N K 3"),
            refl_opacity_logits=(self.refl_opacity_logits, "? N"),
            weight_logits=(self.weight_logits, "? N"),
            refl_sh=(self.refl_sh, "? N L 3"),
        )

    @property
    def split(self) -> bool:
        """Return whether there is a reflected half."""
        return self.refl_sh is not None

    def parameters(self) -> dict[str, Tensor]:
        """Return the stored tensors [N,...] by name."""
        stored = {item.name: getattr(self, item.name) for item in fields(self)}
        return {name: tensor for name, tensor in stored.items() if isinstance(tensor, Tensor)}

    @property
    def sh_degree(self) -> int:
        """Return the spherical-harmonic degree of the transmitted colour."""
        degree: int = round(self.sh.shape[1] ** 0.5) - 1
        return degree

    @property
    def refl_sh_degree(self) -> int:
        """Return the spherical-harmonic degree of the reflected colour; 0 without a reflected half."""
        return 0 if self.refl_sh is None else round(self.refl_sh.shape[1] ** 0.5) - 1

    def scales(self) -> Tensor:
        """Return the standard deviations along the axes, [N,3], in the scene's unit."""
        return activate(self.log_scales)[0]

    def opacities(self) -> Tensor:
        """Return the opacities of the transmitted half, [N], in (0, 1)."""
        return shares(self.opacity_logits)

    def colors(self, camera_center: Tensor, degree: int | None = None) -> Tensor:
        """Return the transmitted colours [N,3] seen from camera_center [3].

        degree: of the harmonics that are used; None: all that are stored.
        """
        return harmonics_to_rgb(self.sh, self.means, camera_center, self.sh_degree if degree is None else degree)

    def refl_opacities(self) -> Tensor:
        """Return the opacities of the reflected half, [N], in (0, 1)."""
        return shares(_stored(self.refl_opacity_logits))

    def weights(self) -> Tensor:
        """Return the reflection weights beta, [N], in (0, 1)."""
        return shares(_stored(self.weight_logits))

    def refl_colors(self, camera_center: Tensor, degree: int | None = None) -> Tensor:
        """Return the reflected colours [N,3] seen from camera_center [3].

        degree: of the harmonics that are used; None: all that are stored.
        """
        degree = self.refl_sh_degree if degree is None else degree
        return harmonics_to_rgb(_stored(self.refl_sh), self.means, camera_center, degree)

    def detached(self) -> GaussianModel:
        """Return a copy that carries no gradients."""
        tensors = {name: tensor.detach().clone() for name, tensor in self.parameters().items()}
        return GaussianModel(**tensors, low_pass=self.low_pass)

    def to(self, device: torch.device) -> GaussianModel:
        """Return the same model on a device (no copy where it already is)."""
        tensors = {name: tensor.to(device) for name, tensor in self.parameters().items()}
        return GaussianModel(**tensors, low_pass=self.low_pass)


def _stored(tensor: Tensor | None) -> Tensor:
    assert tensor is not None, "this model has no reflected light"
    return tensor
