"""How well the rendered normals agree with the rendered depth's slope."""

from __future__ import annotations

from torch import Tensor

from mgsr.data.camera import Camera
from mgsr.ops.depth_normals import depth_to_normals


def normal_agreement(normal: Tensor, depth: Tensor, alpha: Tensor, camera: Camera, covered: Tensor) -> Tensor:
    """L_n: the mean over the covered pixels of 1 - n . n_depth, a scalar.

    normal [H,W,3] world frame, as long as alpha; depth [H,W] camera z; alpha [H,W] scales the depth's normal (as in
    2DGS, eq. 13) and gets no gradient; covered [H,W] 0 or 1. Gradients flow to normal and depth. 0 where nothing is
    covered.
    """
    from_depth = depth_to_normals(depth, camera, alpha=alpha.detach() * covered)
    count = covered.sum()
    agreement = normal.reshape(-1) @ from_depth.reshape(-1)
    return (count - agreement) / count.clamp(min=1)
