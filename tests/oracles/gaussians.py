"""3D Gaussians blended by brute force in float64: every splat at every pixel, straight from the equations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from mgsr.data.camera import Camera

MIN_ALPHA, MAX_ALPHA, MIN_TRANSMITTANCE = 1 / 255, 0.999, 1e-4


@dataclass
class Images:
    color: Tensor
    alpha: Tensor
    depth: Tensor
    reflected: Tensor | None
    weight: Tensor | None


def rotation(quats: Tensor) -> Tensor:
    """Return rotations [N,3,3] of wxyz quaternions of any length, from the axis-angle form of the sandwich product."""
    q = quats / quats.norm(dim=1, keepdim=True)
    w, v = q[:, :1, None], q[:, 1:]
    cross = torch.zeros(len(q), 3, 3, dtype=q.dtype)
    cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = -v[:, 2], v[:, 1], -v[:, 0]
    cross = cross - cross.transpose(1, 2)
    rotations: Tensor = torch.eye(3, dtype=q.dtype) + 2 * w * cross + 2 * cross @ cross
    return rotations


def render(
    means: Tensor,
    quats: Tensor,
    scales: Tensor,
    opacities: Tensor,
    colors: Tensor,
    camera: Camera,
    background: Tensor,
    reflected: Sequence[Tensor] | None = None,
    low_pass: float = 0.3,
    near: float = 0.01,
    compensate: bool = False,
) -> Images:
    """Render Gaussians in float64, with tensors as in mgsr.ops.gaussians; differentiable by autograd."""
    K, pose = torch.as_tensor(camera.K), torch.as_tensor(camera.cam_from_world)
    H, W = camera.height, camera.width
    local = means @ pose[:3, :3].T + pose[:3, 3]
    keep = local[:, 2] > near
    order = torch.argsort(torch.where(keep, local[:, 2], torch.inf).detach(), stable=True)[: int(keep.sum())]
    local = local[order]
    x, y, z = local.unbind(1)
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    center = torch.stack([fx * x / z + cx, fy * y / z + cy], 1)
    tx = (x / z).clamp((-0.15 * W - cx) / fx, (1.15 * W - cx) / fx)
    ty = (y / z).clamp((-0.15 * H - cy) / fy, (1.15 * H - cy) / fy)
    zero = torch.zeros_like(z)
    J = torch.stack([torch.stack([fx / z, zero, -fx * tx / z], 1), torch.stack([zero, fy / z, -fy * ty / z], 1)], 1)
    R = rotation(quats[order])
    sigma = R @ torch.diag_embed(scales[order] ** 2) @ R.transpose(1, 2)
    flat = J @ pose[:3, :3] @ sigma @ pose[:3, :3].T @ J.transpose(1, 2)
    cov = flat + low_pass * torch.eye(2, dtype=means.dtype)
    factor = (torch.det(flat) / torch.det(cov)).clamp(min=0).sqrt() if compensate else torch.ones_like(z)
    rows, columns = torch.meshgrid(torch.arange(H) + 0.5, torch.arange(W) + 0.5, indexing="ij")
    offset = torch.stack([columns, rows], -1).reshape(-1, 1, 2).to(means.dtype) - center  # [P,N,2]
    G = torch.exp(-0.5 * torch.einsum("pni,nij,pnj->pn", offset, torch.linalg.inv(cov), offset))
    background = background.to(means.dtype)

    weights, T = _blend(opacities[order] * factor * G)
    color = weights @ colors[order] + T[:, None] * background
    alpha = 1 - T
    depth = torch.where(alpha > MIN_ALPHA / 2, (weights @ z) / alpha.clamp(min=1e-9), 0.0)
    if reflected is None:
        return Images(color.view(H, W, 3), alpha.view(H, W), depth.view(H, W), None, None)
    refl_opacities, refl_colors, beta = reflected
    refl_weights, _ = _blend(refl_opacities[order] * factor * G)
    return Images(
        color.view(H, W, 3),
        alpha.view(H, W),
        depth.view(H, W),
        (refl_weights @ refl_colors[order]).view(H, W, 3),
        (weights @ beta[order]).view(H, W),
    )


def _blend(raw: Tensor) -> tuple[Tensor, Tensor]:
    """Return blending weights [P,N] and the final transmittance [P], splats in order, for o*G [P,N]."""
    alpha = torch.where(raw >= MIN_ALPHA, raw.clamp(max=MAX_ALPHA), 0.0)
    with torch.no_grad():
        after = torch.cumprod(1 - alpha, 1)
        stopped = torch.cummax((after < MIN_TRANSMITTANCE).to(torch.int8), 1).values.bool()
    alpha = torch.where(stopped, 0.0, alpha)
    after = torch.cumprod(1 - alpha, 1)
    before = torch.cat([torch.ones_like(after[:, :1]), after[:, :-1]], 1)
    final = after[:, -1] if after.shape[1] else torch.ones(len(after), dtype=raw.dtype)
    return alpha * before, final
