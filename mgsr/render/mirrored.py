"""What a surface mirrors in each pixel: the shared light, looked up where the normal throws the line of sight.

Deferred shading: the 2D branch's normals are blended first and mirrored once a pixel. Highlights so follow the shape,
also in views and places where no photograph saw them; and where photographs show them, they shape the normals.
"""

from __future__ import annotations

import torch
from torch import Tensor

from mgsr.data.camera import Camera
from mgsr.gaussians.mirrored import MirroredLight
from mgsr.ops.mirrored import look_up_mirrored


def mirrored_light(light: MirroredLight, normal: Tensor, camera: Camera, pixels: Tensor | None = None) -> Tensor:
    """The light [H,W,3] that comes from where each pixel's surface mirrors the camera's sight to.

    normal [H,W,3]: world frame, of any length; where it is zero, the result means nothing. pixels [P] int64: which to
    look at, row x W + column, each once; elsewhere the result is 0. Gradients flow to the light and to the normals.
    """
    return look_up_mirrored(light.texels(), normal, camera, pixels)


def octahedral(directions: Tensor) -> Tensor:
    """Places [P,2] in -1..1 of directions [3,P], of any length: the octahedron |x|+|y|+|z| = 1 seen from +z, its far
    half folded out over the corners. The same as `octahedral` of native/math/mirrored.h, for pictures of the maps."""
    x, y, z = directions / directions.abs().sum(dim=0).clamp_min(1e-9)
    across, along = torch.where(x >= 0, 1.0, -1.0), torch.where(y >= 0, 1.0, -1.0)
    folded = (1 - y.abs()) * across, (1 - x.abs()) * along
    return torch.stack([torch.where(z < 0, folded[0], x), torch.where(z < 0, folded[1], y)], dim=-1)
