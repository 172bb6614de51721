"""The points on which training begins."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from mgsr.geometry.mesh import Mesh
from mgsr.shading.light_kind import LightKind
from mgsr.shading.lighting import Lighting


class StartSource(StrEnum):
    """The source of the starting points.

    capture: the capture's own points. hull: the visual hull of the masks, or the surface found inside it. stereo:
    PatchMatch stereo. ball: a random ball.
    """

    CAPTURE = "capture"
    HULL = "hull"
    STEREO = "stereo"
    BALL = "ball"


@dataclass(frozen=True)
class StartingPoints:
    """The points on which training begins.

    positions [P,3]: float64, in the scene's frame.
    colors [P,3]: uint8 sRGB.
    normals [P,3]: outward unit normals, None if the surface is unknown.
    light: the light that explains how brightness changes between views; None if that was not examined.
    lighting: a flash's light on the surface, None without a flash.
    surface: the mesh that the points lie on, None without masks.
    surface_pixels: the area of `surface` that views see, in pixels of the photographs at the object; None without a
    surface.
    """

    positions: np.ndarray
    colors: np.ndarray
    source: StartSource
    normals: np.ndarray | None = None
    light: LightKind | None = None
    lighting: Lighting | None = None
    surface: Mesh | None = None
    surface_pixels: float | None = None

    @property
    def shiny(self) -> bool | None:
        """Return whether a flash or a mirrored environment map explains the brightness; None if not examined."""
        return None if self.light is None else self.light is not LightKind.UNKNOWN
