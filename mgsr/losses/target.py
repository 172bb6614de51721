"""What a rendering is compared with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from torch import Tensor

from mgsr.data.camera import Camera


@dataclass(frozen=True)
class Target:
    """One photograph, ready for the losses.

    color [H,W,3] float32 0..1, composited on the background that the rendering has too; alpha [H,W] float32 0..1, or
    None without masks; camera: whose view it is; region (y0, y1, x0, x1), ends excluded: where the photographic losses
    look, None for everywhere.
    """

    color: Tensor
    alpha: Tensor | None
    camera: Camera
    region: tuple[int, int, int, int] | None = None
    off_edge: Tensor | None = None  # [H,W] float32: 0 near the mask's outline, 1 elsewhere; None without masks

    @property
    def distance(self) -> float:
        """The camera's distance from the scene's centre, in the scene's unit."""
        return float(np.linalg.norm(self.camera.center))

    def covered(self, alpha: Tensor) -> Tensor:
        """Pixels [H,W] float32 0 or 1 that have a surface: over half covered by the rendering's alpha [H,W] and,
        with masks, by the photograph's. Depth and normals mean something only there."""
        inside = alpha.detach() > 0.5
        if self.alpha is not None:
            inside &= self.alpha > 0.5
        return inside.to(alpha.dtype)
