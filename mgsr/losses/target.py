"""The target of a rendering: the photograph that it is compared with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from mgsr.data.camera import Camera
from mgsr.ops.pixels import covered


@dataclass(frozen=True)
class Target:
    """One photograph, or a part of it, ready for the losses.

    color [H,W,3] float32 0..1: composited on the same background as the rendering.
    alpha [H,W] float32 0..1: None without masks.
    camera: of the photograph, or of the part.
    invalid [P] int64: the flat indices (row x W + column) of invalid pixels; None if all pixels are valid.
    clipped [H,W,3] bool: where the light may have been brighter than the colour; None if that is unknown.
    share: the target's share of the photograph's pixels.
    """

    color: Tensor
    alpha: Tensor | None
    camera: Camera
    off_edge: Tensor | None = None  # [H,W] float32: 0 near the mask's outline, 1 elsewhere; None without masks
    off_edge_sum: float | None = None  # over all pixels, beside off_edge; None if not computed
    off_edge_share: float = 1.0  # of the photograph's pixels away from the outline
    invalid: Tensor | None = None
    clipped: Tensor | None = None
    share: float = 1.0

    def color_beside(self, rendered: Tensor) -> Tensor:
        """Return the photograph's colours [H,W,3] for a comparison with those of a rendering [H,W,3].

        Where the photograph is clipped and the rendering brighter, they are the rendering's, without a gradient.
        """
        if self.clipped is None:
            return self.color
        return torch.where(self.clipped, torch.maximum(self.color, rendered.detach()), self.color)

    def compared(self, rendered: Tensor, target: Tensor) -> tuple[Tensor, Tensor]:
        """Return a rendering and its target with the same values at invalid pixels, for a loss.

        rendered, target [H,W,...]: images of the same size.

        At invalid pixels both have the rendering's value without a gradient. Such pixels therefore add nothing to a
        loss, also in windows that contain some of them.
        """
        if self.invalid is None:
            return rendered, target
        still = rendered.detach().flatten(0, 1).index_select(0, self.invalid)
        alike = (image.flatten(0, 1).index_copy(0, self.invalid, still).view_as(image) for image in (rendered, target))
        return next(alike), next(alike)

    def valid_weights(self, weights: Tensor) -> Tensor:
        """Return the weights [H,W] with 0 at invalid pixels."""
        if self.invalid is None:
            return weights
        return weights.flatten().index_fill(0, self.invalid, 0).view_as(weights)

    @property
    def distance(self) -> float:
        """Return the camera's distance from the scene's centre, in the scene's unit."""
        return float(np.linalg.norm(self.camera.center))

    def covered(self, alpha: Tensor) -> Tensor:
        """Return a mask [H,W] float32, 0 or 1, of the pixels that show the surface, where depth and normals count.

        These pixels are valid. The rendering's alpha [H,W] exceeds one half there and, with masks, the photograph's.
        """
        return self.valid_weights(covered(alpha, self.alpha))
