"""Clone, split and prune, and lower opacities (3DGS, section 5).

Small splats with a large screen-space gradient are cloned, large ones split in two, faint and huge ones pruned.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from mgsr.config import DensifyConfig
from mgsr.densify.state import DensifyState

OPACITY_NAMES = ("opacity_logits", "refl_opacity_logits")

Parameters = dict[str, Tensor]


@dataclass(frozen=True)
class Adaptation:
    """A new set of splats: those kept, by ascending index [M] int64, then those added (tensors as the model's)."""

    kept: Tensor
    added: Parameters
    cloned: int
    split: int


def adapt(
    parameters: Parameters,
    state: DensifyState,
    config: DensifyConfig,
    extent: float,
    generator: torch.Generator,
    grow: bool = True,
) -> Adaptation:
    """Return the next set of splats, from the stored parameters of either branch (`model.parameters()`).

    extent: the scene's, in its unit. grow: off only prunes. Parameters and state remain unchanged. The two
    halves of a split are drawn from the splat itself by the generator. Deviation from 3DGS: what would pass
    config.max_count is left out, smallest gradients first; no limit on screen size.
    """
    parameters = {name: tensor.detach() for name, tensor in parameters.items()}
    longest = parameters["log_scales"].amax(dim=1).exp()
    keep = visible_enough(parameters, config.prune_opacity) & (longest <= config.prune_above * extent)
    nothing = keep.new_zeros(keep.shape)
    hot = _hottest(state.mean_gradients(), keep, config) if grow else nothing
    large = longest > config.split_above * extent
    clone, split = hot & ~large, hot & large
    halves = split_in_two(_rows(parameters, split), config.split_shrink, generator)
    copies = _rows(parameters, clone)
    return Adaptation(
        kept=(keep & ~split).nonzero().squeeze(1),
        added={name: torch.cat([copies[name], halves[name]]) for name in parameters},
        cloned=int(clone.sum()),
        split=int(split.sum()),
    )


def visible_enough(parameters: Parameters, opacity: float) -> Tensor:
    """Return which splats [N] have at least this opacity, in either half where there are two."""
    opacities = parameters["opacity_logits"].sigmoid()
    if "refl_opacity_logits" in parameters:
        opacities = torch.maximum(opacities, parameters["refl_opacity_logits"].sigmoid())
    return opacities >= opacity


def split_in_two(parameters: Parameters, shrink: float, generator: torch.Generator) -> Parameters:
    """Return each splat's two halves: centres drawn from its own distribution, scales divided by `shrink`.

    The result has twice as many rows: all first halves, then all second ones.
    """
    doubled = {name: torch.cat([tensor, tensor]) for name, tensor in parameters.items()}
    scales = doubled["log_scales"].exp()
    drawn = torch.randn(scales.shape, generator=generator).to(scales.device) * scales
    if drawn.shape[1] == 2:  # a surfel is flat
        drawn = torch.nn.functional.pad(drawn, (0, 1))
    rotations = rotation_matrices(doubled["quats"])
    doubled["means"] = doubled["means"] + (rotations @ drawn[:, :, None]).squeeze(2)
    doubled["log_scales"] = doubled["log_scales"] - torch.tensor(shrink).log()
    return doubled


def rotation_matrices(quats: Tensor) -> Tensor:
    """Return the rotations [N,3,3] of quaternions [N,4] wxyz, which need not be unit."""
    w, x, y, z = torch.nn.functional.normalize(quats, dim=1).unbind(1)
    rows = [
        torch.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], dim=1),
        torch.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], dim=1),
        torch.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], dim=1),
    ]
    return torch.stack(rows, dim=1)


def _hottest(gradients: Tensor, keep: Tensor, config: DensifyConfig) -> Tensor:
    """Return which splats [N] to clone or split: those whose gradient is over the threshold.

    gradients [N]; keep [N] bool: the splats that stay. Where the count would pass its cap, only the steepest are
    chosen.
    """
    hot = keep & (gradients > config.gradient_threshold)
    room = max(0, config.max_count - int(keep.sum()))
    if int(hot.sum()) > room:
        order = torch.where(hot, gradients, gradients.new_tensor(-1.0)).argsort(descending=True, stable=True)
        hot = torch.zeros_like(hot)
        hot[order[:room]] = True
    return hot


def _rows(parameters: Parameters, mask: Tensor) -> Parameters:
    """Return the parameters of the splats where the mask [N] bool is True."""
    return {name: tensor[mask] for name, tensor in parameters.items()}


def lowered_opacities(parameters: dict[str, Tensor], opacity: float) -> dict[str, Tensor]:
    """Return a branch's opacity logits [N] by name, clamped to the logit of `opacity` (3DGS, section 5.2).

    Superfluous splats then remain faint and are pruned. `parameters` remain unchanged.
    """
    limit = math.log(opacity / (1 - opacity))
    return {name: parameters[name].detach().clamp(max=limit) for name in OPACITY_NAMES if name in parameters}
