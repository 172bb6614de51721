"""Normals of a depth map by back-projecting to world points and taking cross products."""

from __future__ import annotations

import torch


def depth_to_normals(depth: torch.Tensor, K: torch.Tensor, cam_from_world: torch.Tensor) -> torch.Tensor:
    height, width = depth.shape
    y, x = torch.meshgrid(
        torch.arange(height, dtype=depth.dtype) + 0.5, torch.arange(width, dtype=depth.dtype) + 0.5, indexing="ij"
    )
    rays = torch.stack([x, y, torch.ones_like(x)], -1) @ torch.linalg.inv(K).T
    rotation, translation = cam_from_world[:3, :3], cam_from_world[:3, 3]
    points = (rays * depth[..., None] - translation) @ rotation
    across = points[1:-1, 2:] - points[1:-1, :-2]
    down = points[2:, 1:-1] - points[:-2, 1:-1]
    cross = torch.linalg.cross(across, down)
    toward_camera = -rays[1:-1, 1:-1] @ rotation
    cross = cross * torch.sign((cross * toward_camera).sum(-1, keepdim=True))
    has = depth > 0
    valid = has[1:-1, 1:-1] & has[1:-1, 2:] & has[1:-1, :-2] & has[2:, 1:-1] & has[:-2, 1:-1]
    unit = cross / torch.where(valid, cross.norm(dim=-1), 1.0)[..., None]
    inner = torch.where(valid[..., None], unit, 0.0)
    return torch.nn.functional.pad(inner, (0, 0, 1, 1, 1, 1))
