"""What a surface mirrors in each pixel: the shared light, looked up where the normal throws the line of sight.

Deferred shading: the 2D branch's normals are blended first and mirrored once a pixel. Highlights so follow the shape,
also in views and places where no photograph saw them; and where photographs show them, they shape the normals.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import grid_sample, pad

from mgsr.data.camera import Camera
from mgsr.gaussians.mirrored import MirroredLight

Region = tuple[int, int, int, int]


def mirrored_light(
    light: MirroredLight, normal: Tensor, camera: Camera, region: Region | None = None
) -> Tensor:
    """The light [H,W,3] that comes from where each pixel's surface mirrors the camera's sight to.

    normal [H,W,3]: world frame, of any length; where it is zero, the result means nothing. region (y0, y1, x0, x1),
    ends excluded: outside it the result is 0. Gradients flow to the light and to the normals.
    """
    height, width = normal.shape[:2]
    y0, y1, x0, x1 = region or (0, height, 0, width)
    rotation = torch.tensor(camera.cam_from_world[:3, :3], dtype=normal.dtype).to(normal.device, non_blocking=True)
    facing = rotation @ normal[y0:y1, x0:x1].reshape(-1, 3).T
    facing = facing / facing.square().sum(dim=0).clamp_min(1e-12).sqrt()
    back = _towards_camera(camera, (y0, y1, x0, x1), normal)
    mirrored = 2 * (facing * back).sum(dim=0) * facing - back
    flipped = torch.stack([mirrored[0], mirrored[1], -mirrored[2]])
    places = torch.stack([octahedral(rotation.T @ mirrored), octahedral(flipped)])
    shown = grid_sample(light.maps(), places[:, None], padding_mode="border", align_corners=False)
    image = shown.sum(dim=0)[:, 0].T.reshape(y1 - y0, x1 - x0, 3)
    return image if region is None else pad(image, (0, 0, x0, width - x1, y0, height - y1))


def octahedral(directions: Tensor) -> Tensor:
    """Places [P,2] in -1..1 of directions [3,P], of any length: the octahedron |x|+|y|+|z| = 1 seen from +z, its far
    half folded out over the corners."""
    x, y, z = directions / directions.abs().sum(dim=0).clamp_min(1e-9)
    across, along = torch.where(x >= 0, 1.0, -1.0), torch.where(y >= 0, 1.0, -1.0)
    folded = (1 - y.abs()) * across, (1 - x.abs()) * along
    return torch.stack([torch.where(z < 0, folded[0], x), torch.where(z < 0, folded[1], y)], dim=-1)


def _towards_camera(camera: Camera, region: Region, like: Tensor) -> Tensor:
    """Unit directions [3,P] from each pixel's surface to the camera, in the camera's axes."""
    y0, y1, x0, x1 = region
    K = camera.K
    columns = (torch.arange(x0, x1, dtype=like.dtype, device=like.device) + (0.5 - K[0, 2])) / K[0, 0]
    rows = (torch.arange(y0, y1, dtype=like.dtype, device=like.device) + (0.5 - K[1, 2])) / K[1, 1]
    along, across = torch.meshgrid(rows, columns, indexing="ij")
    rays = torch.stack([across, along, torch.ones_like(across)]).reshape(3, -1)
    return -rays / rays.square().sum(dim=0).sqrt()
