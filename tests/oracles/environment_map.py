"""The environment map by torch's own operations, in any precision."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import grid_sample


def look_up_environment_map(
    maps: Tensor, normals: Tensor, K: Tensor, cam_from_world: Tensor, pixels: Tensor | None = None
) -> Tensor:
    """Return the light [H,W,3] of maps [2,S,S,3] that a surface with normals [H,W,3] mirrors towards a camera.

    The camera has K [3,3] and cam_from_world [4,4]. The light is at pixels [P] alone, where they are given.
    """
    height, width = normals.shape[:2]
    every, rotation = normals.reshape(-1, 3), cam_from_world[:3, :3]
    pixels = torch.arange(height * width) if pixels is None else pixels
    facing = rotation @ every.index_select(0, pixels).T
    facing = facing / facing.square().sum(dim=0).clamp_min(1e-12).sqrt()
    back = towards_camera(K, width, pixels)
    mirrored = 2 * (facing * back).sum(dim=0) * facing - back
    flipped = torch.stack([mirrored[0], mirrored[1], -mirrored[2]])
    places = torch.stack([octahedral(rotation.T @ mirrored), octahedral(flipped)])
    shown = grid_sample(maps.permute(0, 3, 1, 2), places[:, None], padding_mode="border", align_corners=False)
    colors = shown.sum(dim=0)[:, 0].T
    return torch.zeros_like(every).index_copy(0, pixels, colors).reshape(height, width, 3)


def look_up_samples(
    maps: Tensor, samples: Tensor, K: Tensor, cam_from_world: Tensor, pixels: Tensor, size: tuple[int, int]
) -> Tensor:
    """Return the light [H,W,3] of pixels [P] with samples [P,N,N,3], as the sum over an image N times as large."""
    (height, width), rows = size, samples.shape[1]
    fine = torch.zeros(height, rows, width, rows, 3, dtype=samples.dtype)
    fine = fine.permute(0, 2, 1, 3, 4).reshape(height * width, rows, rows, 3).index_copy(0, pixels, samples)
    normals = fine.view(height, width, rows, rows, 3).permute(0, 2, 1, 3, 4).reshape(height * rows, width * rows, 3)
    larger = K.clone()
    larger[:2] *= rows
    weights = normals.square().sum(dim=-1, keepdim=True)
    weights = torch.where(weights > 0, weights, 0).sqrt()
    light = look_up_environment_map(maps, normals, larger, cam_from_world) * weights
    return light.view(height, rows, width, rows, 3).sum(dim=(1, 3))


def octahedral(directions: Tensor) -> Tensor:
    """Return the places [P,2] in -1..1 of directions [3,P]."""
    x, y, z = directions / directions.abs().sum(dim=0).clamp_min(1e-9)
    across, along = torch.where(x >= 0, 1.0, -1.0), torch.where(y >= 0, 1.0, -1.0)
    folded = (1 - y.abs()) * across, (1 - x.abs()) * along
    return torch.stack([torch.where(z < 0, folded[0], x), torch.where(z < 0, folded[1], y)], dim=-1)


def towards_camera(K: Tensor, width: int, pixels: Tensor) -> Tensor:
    """Return unit directions [3,P] from the surface to the camera, in its axes."""
    across = ((pixels % width).to(K) + (0.5 - K[0, 2])) / K[0, 0]
    along = (torch.div(pixels, width, rounding_mode="floor").to(K) + (0.5 - K[1, 2])) / K[1, 1]
    rays = torch.stack([across, along, torch.ones_like(across)])
    return -rays / rays.square().sum(dim=0).sqrt()
