"""2D surfels, brute force in plain torch: every splat on every pixel, by intersecting rays with planes.

Written from the definitions (2DGS, Eq. 4-10; method.md, "2D branch") and sharing no code with `mgsr`. Works in the
dtype of its inputs (float64 in the tests) and is differentiable by autograd.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch

MIN_ALPHA = 1 / 255
MAX_ALPHA = 0.999
MIN_TRANSMITTANCE = 1e-4
LOW_PASS_VARIANCE = 0.1
EDGE_ON_SINE = 1e-3


@dataclass
class SurfelImages:
    """The images of a rendering.

    color [H,W,3] with background, alpha [H,W], depth, median_depth, distortion [H,W], normal [H,W,3] (world).
    """

    color: torch.Tensor
    alpha: torch.Tensor
    depth: torch.Tensor
    median_depth: torch.Tensor
    normal: torch.Tensor
    distortion: torch.Tensor


def rotation_matrices(quats: torch.Tensor) -> torch.Tensor:
    """Return rotations [N,3,3] from unnormalised wxyz quaternions [N,4]."""
    w, x, y, z = (quats / quats.norm(dim=-1, keepdim=True)).unbind(-1)
    rows = [
        torch.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], -1),
        torch.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], -1),
        torch.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], -1),
    ]
    return torch.stack(rows, -2)


def pixel_rays(K: torch.Tensor, width: int, height: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Return pixel centres [P,2] and the camera-frame rays through them with z = 1, [P,3]; rows first."""
    y, x = torch.meshgrid(
        torch.arange(height, dtype=K.dtype) + 0.5, torch.arange(width, dtype=K.dtype) + 0.5, indexing="ij"
    )
    pixels = torch.stack([x.reshape(-1), y.reshape(-1)], -1)
    homogeneous = torch.cat([pixels, torch.ones_like(pixels[:, :1])], -1)
    return pixels, homogeneous @ torch.linalg.inv(K).T


def render(
    means: torch.Tensor,
    quats: torch.Tensor,
    scales: torch.Tensor,
    opacities: torch.Tensor,
    colors: torch.Tensor,
    K: torch.Tensor,
    cam_from_world: torch.Tensor,
    width: int,
    height: int,
    background: torch.Tensor,
    near: float = 0.01,
    far: float = 100.0,
    shift: torch.Tensor | None = None,
) -> SurfelImages:
    """Render all outputs.

    `shift` [N,2] moves each splat's weights in the image plane (pixels), keeping their shape.
    """
    local = means @ cam_from_world[:3, :3].T + cam_from_world[:3, 3]
    order = torch.argsort(local[:, 2].detach(), stable=True)
    order = order[(local[order, 2] > near) & (opacities[order] >= MIN_ALPHA)]
    local, opacities, colors, scales = local[order], opacities[order], colors[order], scales[order]
    world_axes = rotation_matrices(quats[order])
    axes = cam_from_world[:3, :3] @ world_axes
    towards = -torch.sign((axes[:, :, 2] * local).sum(-1)).detach()
    normals = world_axes[:, :, 2] * towards[:, None]

    pixels, rays = pixel_rays(K, width, height)
    shift = torch.zeros_like(local[:, :2]) if shift is None else shift[order]
    focal = torch.stack([K[0, 0], K[1, 1]])
    centres = local[:, :2] / local[:, 2:] * focal + K[:2, 2] + shift

    shifted = rays[:, None] - torch.cat([shift / focal, torch.zeros_like(shift[:, :1])], -1)  # [P,N,3]
    plane = (axes[:, :, 2] * local).sum(-1)
    slope = (shifted * axes[:, :, 2]).sum(-1)
    hit_depth = plane / torch.where(slope == 0, torch.ones_like(slope), slope)
    offset = shifted * hit_depth[..., None] - local
    u = (offset * axes[:, :, 0]).sum(-1) / scales[:, 0]
    v = (offset * axes[:, :, 1]).sum(-1) / scales[:, 1]
    edge_on = plane.abs() < EDGE_ON_SINE * local.norm(dim=-1)
    usable = (slope != 0) & (hit_depth > near) & ~edge_on
    hit = torch.where(usable, u * u + v * v, torch.full_like(u, torch.inf))
    blur = ((pixels[:, None] - centres) ** 2).sum(-1) / LOW_PASS_VARIANCE
    through_hit = hit <= blur
    weight = torch.exp(-0.5 * torch.where(through_hit, hit, blur))
    z = torch.where(through_hit, hit_depth, local[:, 2].expand_as(hit_depth))

    alpha = (opacities * weight).clamp(max=MAX_ALPHA)
    alpha = torch.where(alpha >= MIN_ALPHA, alpha, torch.zeros_like(alpha))
    stops = torch.cumprod(1 - alpha, 1) < MIN_TRANSMITTANCE
    alpha = torch.where(torch.cummax(stops.to(torch.int8), 1).values.bool(), torch.zeros_like(alpha), alpha)
    before = _exclusive_product(1 - alpha)
    after = before * (1 - alpha)
    share = alpha * before
    final = torch.prod(1 - alpha, dim=1)
    total = 1 - final
    depth = (share * z).sum(1) / torch.where(total > 0, total, torch.ones_like(total))
    median = torch.where((before >= 0.5) & (after < 0.5), z, torch.zeros_like(z)).sum(1)
    m = (z - near) / (far - near)
    distortion = (share * (m * m)).sum(1) * share.sum(1) - (share * m).sum(1) ** 2

    def image(values: torch.Tensor) -> torch.Tensor:
        return values.reshape(height, width, *values.shape[1:])

    return SurfelImages(
        color=image(share @ colors + final[:, None] * background),
        alpha=image(total),
        depth=image(depth),
        median_depth=image(median),
        normal=image(share @ normals),
        distortion=image(distortion),
    )


def _exclusive_product(factors: torch.Tensor) -> torch.Tensor:
    """Return the product of all factors before each one, along the splats."""
    return torch.cumprod(torch.cat([torch.ones_like(factors[:, :1]), factors], 1), 1)[:, :-1]
