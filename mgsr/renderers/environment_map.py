"""The environment map in each pixel, looked up where the normal reflects the line of sight.

Deferred shading: the line of sight is reflected at the 2D branch's blended normals, once a pixel, or at the mesh once
there is one, in several samples of a pixel. Highlights thus follow the shape, also in views and places without a
photograph of them. Where photographs show highlights, they improve the 2D branch's normals.
"""

from __future__ import annotations

import torch
from torch import Tensor

from mgsr.data.camera import Camera
from mgsr.gaussians.environment_map import EnvironmentMap, RenderedMap
from mgsr.ops.environment_map import look_up_environment_map, look_up_samples


def reflected_environment(
    environment_map: EnvironmentMap,
    camera: Camera,
    normal: Tensor | None = None,
    pixels: Tensor | None = None,
    rendered: RenderedMap | None = None,
) -> Tensor:
    """Return the light [H,W,3] that each pixel's surface reflects towards the camera.

    normal [H,W,3]: the 2D branch's, world frame, of any length, for a map without a reflector; where it is zero, the
    result is undefined. pixels [P] int64: which to look at, row x W + column, each once, for a map without a reflector;
    elsewhere the result is 0; by default all. A reflector is looked at wherever it is, and beside it. rendered: the
    result of `EnvironmentMap.rendered`, if already computed. Gradients flow to the map and to the normals.
    """
    rendered = environment_map.rendered() if rendered is None else rendered
    if environment_map.reflector is None:
        assert normal is not None
        return look_up_environment_map(rendered.texels, normal, camera, pixels)
    seen = environment_map.reflector.seen_by(camera, rendered.texels.device)
    shown = look_up_samples(rendered.texels, seen.samples.float(), camera, seen.pixels)
    if not len(seen.bounced):
        return shown
    return shown + rendered.bounce * look_up_samples(rendered.texels, seen.bounced.float(), camera, seen.bounced_pixels)


def octahedral(directions: Tensor) -> Tensor:
    """Map directions [3,P], of any length, to places [P,2] in -1..1 of an octahedral map.

    It is the octahedron |x|+|y|+|z| = 1 seen from +z, its far half folded out over the corners. The same as
    `octahedral` of native/math/environment_map.h, for pictures of the maps.
    """
    x, y, z = directions / directions.abs().sum(dim=0).clamp_min(1e-9)
    across, along = torch.where(x >= 0, 1.0, -1.0), torch.where(y >= 0, 1.0, -1.0)
    folded = (1 - y.abs()) * across, (1 - x.abs()) * along
    return torch.stack([torch.where(z < 0, folded[0], x), torch.where(z < 0, folded[1], y)], dim=-1)
