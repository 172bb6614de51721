"""The outputs of a rendering: named images of one camera."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from mgsr.data.camera import Camera


@dataclass(frozen=True)
class SurfelOutputs:
    """The 2D branch's images of one camera.

    color [H,W,3]: with the background.
    alpha [H,W]: the coverage, 0..1.
    depth [H,W], median_depth [H,W]: the mean and the median of the blend, camera z; 0 without surfels.
    normal [H,W,3]: in the world frame, towards the camera, of length alpha.
    distortion [H,W]: 2DGS's depth distortion; None if it was not asked for.
    stats: screen-space figures of each surfel (see mgsr/ops).
    unlit [H,W,3]: the colour under even light; None without a flash.
    """

    color: Tensor
    alpha: Tensor
    depth: Tensor
    median_depth: Tensor
    normal: Tensor
    distortion: Tensor | None
    stats: Any
    unlit: Tensor | None = None


@dataclass(frozen=True)
class GaussianOutputs:
    """The 3D branch's images of one camera.

    color [H,W,3]: transmitted + weight * reflected.
    transmitted [H,W,3]: with the background.
    reflected [H,W,3], weight [H,W]: the reflected light and its weight; None without a light split.
    depth [H,W]: camera z, 0 without Gaussians; None if it was not asked for.
    alpha [H,W]: the coverage by the transmitted half, 0..1.
    stats: screen-space figures of each Gaussian (see mgsr/ops).
    own_reflected [H,W,3]: the Gaussians' own part of reflected; None without one.
    environment [H,W,3]: the environment map's part of reflected; None without one.
    unlit [H,W,3]: the transmitted colour under even light; None without a flash.
    """

    color: Tensor
    transmitted: Tensor
    reflected: Tensor | None
    weight: Tensor | None
    depth: Tensor | None
    alpha: Tensor
    stats: Any
    own_reflected: Tensor | None = None
    environment: Tensor | None = None
    unlit: Tensor | None = None


def camera_center(camera: Camera) -> Tensor:
    """Return the camera's centre [3] float32, world, on the processor, which hands it to the kernels."""
    return torch.from_numpy(camera.center.astype(np.float32))
