"""What a surface mirrors in each pixel: the shared light, looked up where the normal throws the line of sight.

Deferred shading: the 2D branch's normals are blended first and mirrored once a pixel. Highlights so follow the shape,
also in views and places where no photograph saw them; and where photographs show them, they shape the normals.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import grid_sample

from mgsr.data.camera import Camera
from mgsr.gaussians.mirrored import MirroredLight


def mirrored_light(light: MirroredLight, normal: Tensor, camera: Camera, pixels: Tensor | None = None) -> Tensor:
    """The light [H,W,3] that comes from where each pixel's surface mirrors the camera's sight to.

    normal [H,W,3]: world frame, of any length; where it is zero, the result means nothing. pixels [P] int64: which to
    look at, row x W + column, each once; elsewhere the result is 0. Gradients flow to the light and to the normals.
    """
    height, width = normal.shape[:2]
    every = normal.reshape(-1, 3)
    rotation = torch.tensor(camera.cam_from_world[:3, :3], dtype=normal.dtype).to(normal.device, non_blocking=True)
    facing = rotation @ (every if pixels is None else every.index_select(0, pixels)).T
    facing = facing / facing.square().sum(dim=0).clamp_min(1e-12).sqrt()
    back = _towards_camera(camera, pixels, normal)
    mirrored = 2 * (facing * back).sum(dim=0) * facing - back
    flipped = torch.stack([mirrored[0], mirrored[1], -mirrored[2]])
    places = torch.stack([octahedral(rotation.T @ mirrored), octahedral(flipped)])
    shown = grid_sample(light.maps(), places[:, None], padding_mode="border", align_corners=False)
    colors = shown.sum(dim=0)[:, 0].T
    image = colors if pixels is None else torch.zeros_like(every).index_copy(0, pixels, colors)
    return image.reshape(height, width, 3)


def octahedral(directions: Tensor) -> Tensor:
    """Places [P,2] in -1..1 of directions [3,P], of any length: the octahedron |x|+|y|+|z| = 1 seen from +z, its far
    half folded out over the corners."""
    x, y, z = directions / directions.abs().sum(dim=0).clamp_min(1e-9)
    across, along = torch.where(x >= 0, 1.0, -1.0), torch.where(y >= 0, 1.0, -1.0)
    folded = (1 - y.abs()) * across, (1 - x.abs()) * along
    return torch.stack([torch.where(z < 0, folded[0], x), torch.where(z < 0, folded[1], y)], dim=-1)


def _towards_camera(camera: Camera, pixels: Tensor | None, like: Tensor) -> Tensor:
    """Unit directions [3,P] from each pixel's surface to the camera, in the camera's axes."""
    if pixels is None:
        pixels = torch.arange(camera.height * camera.width, device=like.device)
    K = camera.K
    across = ((pixels % camera.width).to(like.dtype) + (0.5 - K[0, 2])) / K[0, 0]
    along = (torch.div(pixels, camera.width, rounding_mode="floor").to(like.dtype) + (0.5 - K[1, 2])) / K[1, 1]
    rays = torch.stack([across, along, torch.ones_like(across)])
    return -rays / rays.square().sum(dim=0).sqrt()
