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
    alpha [H,W]: opacity.
    depth [H,W]: the blended mean camera z; 0 where nothing is.
    median_depth [H,W]: the blended median camera z; 0 where nothing is.
    normal [H,W,3]: in the world frame, towards the camera, of length alpha.
    distortion [H,W]: None if not requested.
    stats: screen-space statistics of each surfel (see `mgsr/ops`).
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
    reflected [H,W,3], weight [H,W]: None without a light split.
    own_reflected [H,W,3]: the part of `reflected` from the splats; None without one.
    environment [H,W,3]: the part of `reflected` from the environment map; None without one.
    unlit [H,W,3]: `transmitted` under even light; None without a flash.
    depth [H,W]: camera z; 0 where nothing is; None if not requested.
    alpha [H,W]: opacity of the transmitted half.
    stats: screen-space statistics of each Gaussian (see `mgsr/ops`).
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
