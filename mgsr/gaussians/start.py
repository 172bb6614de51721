"""Initial parameters of both branches from starting points."""

from __future__ import annotations

import math

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from mgsr.config import GaussianConfig, SurfelConfig
from mgsr.errors import TrainingError
from mgsr.gaussians.gaussians import GaussianModel
from mgsr.gaussians.surfels import SurfelModel

SH_CONSTANT = 0.28209479177387814  # the spherical harmonic of degree 0
MIN_POINTS = 4  # a spacing needs three neighbours


def start_surfels(
    positions: np.ndarray,
    normals: np.ndarray | None,
    colors: np.ndarray,
    config: SurfelConfig,
    generator: torch.Generator,
) -> SurfelModel:
    """Build surfels on points: flat along the normals, as wide as the points' spacing.

    positions [P,3] in the scene's frame; normals [P,3] or None (then from the neighbours' plane); colors [P,3] uint8 or
    float 0..1, sRGB. More than config.max_start points are thinned by the generator.

    Raises TrainingError for fewer than four points or non-finite ones.
    """
    positions, normals, colors = _thinned(positions, normals, colors, config.max_start, generator)
    spacing, neighbours = _neighbourhood(positions)
    if normals is None:
        normals = plane_normals(positions, neighbours)
    log_scale = np.log(spacing * config.start_scale)
    return SurfelModel(
        means=_tensor(positions),
        quats=_tensor(quats_from_normals(normals)),
        log_scales=_tensor(np.repeat(log_scale[:, None], 2, axis=1)),
        opacity_logits=torch.full((len(positions),), logit(config.start_opacity)),
        sh=_sh(_tensor(colors), config.sh_degree),
    )


def start_gaussians(
    positions: np.ndarray,
    normals: np.ndarray | None,
    colors: np.ndarray,
    config: GaussianConfig,
    generator: torch.Generator,
    split: bool,
) -> GaussianModel:
    """Build round Gaussians on points, as wide as the points' spacing.

    positions, normals, colors [P,3]: as in `start_surfels`, as are the other arguments and the errors. split: whether
    the Gaussians have their own reflected half.
    """
    positions, normals, colors = _thinned(positions, normals, colors, config.max_start, generator)
    spacing, _ = _neighbourhood(positions)
    sizes = _tensor(spacing * config.start_scale)
    tensors = round_gaussians(_tensor(positions), sizes, _tensor(colors), config.start_opacity, config.sh_degree)
    model = GaussianModel(**tensors, low_pass=config.low_pass)
    if not split:
        return model
    return GaussianModel(**model.parameters(), **reflected_half(model, config), low_pass=config.low_pass)


def round_gaussians(
    positions: Tensor, sizes: Tensor, colors: Tensor, opacity: float, sh_degree: int
) -> dict[str, Tensor]:
    """Return the stored tensors of round Gaussians without a reflected half, on the positions' device.

    positions [P,3] in the scene's frame; sizes [P]: standard deviations, in the scene's unit; colors [P,3] sRGB 0..1.
    """
    count, device = len(positions), positions.device
    return {
        "means": positions,
        "quats": torch.tensor([[1.0, 0.0, 0.0, 0.0]], device=device).repeat(count, 1),
        "log_scales": sizes.log()[:, None].repeat(1, 3),
        "opacity_logits": torch.full((count,), logit(opacity), device=device),
        "sh": _sh(colors, sh_degree),
    }


def new_gaussians(
    model: GaussianModel, positions: Tensor, sizes: Tensor, colors: Tensor, opacity: float, config: GaussianConfig
) -> dict[str, Tensor]:
    """Return the stored tensors [N,...] of round Gaussians to append to a model.

    They have the model's harmonic degrees, and a reflected half if the model has one. positions [P,3], sizes [P],
    colors [P,3]: as in `round_gaussians`.
    """
    tensors = round_gaussians(positions, sizes, colors, opacity, model.sh_degree)
    if not model.split:
        return tensors
    return tensors | reflected_half(GaussianModel(**tensors, low_pass=model.low_pass), config)


def reflected_half(model: GaussianModel, config: GaussianConfig) -> dict[str, Tensor]:
    """Return by name the tensors [N,...] of an initial reflected half for Gaussians without one."""
    count, device = len(model), model.means.device
    reflected = torch.full((count, 3), config.start_reflected, device=device)
    return {
        "refl_opacity_logits": model.opacity_logits.detach().clone(),
        "weight_logits": torch.full((count,), logit(config.start_weight), device=device),
        "refl_sh": _sh(reflected, config.reflected_sh_degree),
    }


def logit(probability: float) -> float:
    """Return the logit of `probability`, which must lie inside (0, 1)."""
    return math.log(probability / (1 - probability))


def quats_from_normals(normals: np.ndarray) -> np.ndarray:
    """Return the quaternions [P,4] wxyz of the shortest rotations that take z to the normals [P,3] of any length."""
    unit = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    x, y, z = unit.T
    quats = np.stack([1 + z, -y, x, np.zeros_like(x)], axis=1)
    quats[z < -1 + 1e-6] = [0.0, 1.0, 0.0, 0.0]  # straight down: any half turn about a level axis
    unit_quats: np.ndarray = quats / np.linalg.norm(quats, axis=1, keepdims=True)
    return unit_quats


def plane_normals(positions: np.ndarray, neighbours: np.ndarray) -> np.ndarray:
    """Return the unit normals [P,3], of either sign, of the planes through each point's neighbours.

    positions [P,3]; neighbours [P,k]: their indices.
    """
    local = positions[neighbours] - positions[neighbours].mean(axis=1, keepdims=True)
    _, vectors = np.linalg.eigh(local.transpose(0, 2, 1) @ local)
    return vectors[:, :, 0]


def _thinned(
    positions: np.ndarray,
    normals: np.ndarray | None,
    colors: np.ndarray,
    limit: int,
    generator: torch.Generator,
) -> tuple[np.ndarray, np.ndarray | None, np.ndarray]:
    """Draw at most `limit` of the points [P,3], and convert their colours [P,3] to floats 0..1.

    Raises TrainingError for fewer than MIN_POINTS points or non-finite ones.
    """
    if len(positions) < MIN_POINTS:
        raise TrainingError(f"starting points: expected at least {MIN_POINTS}, got {len(positions)}")
    if not np.isfinite(positions).all():
        raise TrainingError("starting points: some positions are not finite; remove them")
    if colors.dtype == np.uint8:
        colors = colors / 255.0
    if len(positions) <= limit:
        return positions, normals, colors
    chosen = torch.randperm(len(positions), generator=generator)[:limit].sort().values.numpy()
    return positions[chosen], None if normals is None else normals[chosen], colors[chosen]


def _neighbourhood(positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean distance [P] to the three nearest other points, and neighbour indices [P,k].

    The neighbours are the point itself and up to eight nearest ones. Distances are clipped to 0.05 to 10 times their
    median.
    """
    near = min(9, len(positions))
    distances, neighbours = cKDTree(positions).query(positions, k=near)
    spacing = distances[:, 1:4].mean(axis=1)
    # Coincident points would give splats of size zero, and a stray point a splat as large as the scene.
    middle = max(float(np.median(spacing)), 1e-7)
    return np.clip(spacing, 0.05 * middle, 10 * middle), neighbours


def _sh(colors: Tensor, degree: int) -> Tensor:
    """Return the harmonics [N,K,3] of a degree that show colours [N,3] sRGB 0..1 from all sides."""
    sh = torch.zeros(len(colors), (degree + 1) ** 2, 3, device=colors.device)
    sh[:, 0] = (colors - 0.5) / SH_CONSTANT
    return sh


def _tensor(array: np.ndarray) -> Tensor:
    """Return an array [...] as a float32 tensor."""
    return torch.from_numpy(np.ascontiguousarray(array, dtype=np.float32))
