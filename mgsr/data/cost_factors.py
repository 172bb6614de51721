"""The properties of a scene that determine how long a run takes."""

from __future__ import annotations

from dataclasses import dataclass

USUAL_PIXELS = 256 * 256
USUAL_VIEWS = 48
GROWTH = 0.7  # exponent by which the time of work on a surface grows with the photographs' pixels


@dataclass(frozen=True)
class CostFactors:
    """The factors of a scene's cost.

    views, tests: number of training and test views.
    pixels: mean pixels of a view.
    truth: whether the capture has its true surface.
    shiny: whether shading may refine the mesh.
    masked: whether there are masks.
    learned: whether masks are learned, as there are none.
    flash: whether the light is a flash.
    searched: whether an object is searched for, as there are no masks.
    surface_pixels: the area of the object's surface, in pixels of the photographs; None if it is unknown.
    """

    views: int
    tests: int
    pixels: float
    truth: bool
    shiny: bool = True
    masked: bool = True
    learned: bool = False
    flash: bool = False
    searched: bool = False
    surface_pixels: float | None = None

    @property
    def size(self) -> float:
        """Return the pixels of a view as a share of the usual."""
        return self.pixels / USUAL_PIXELS

    @property
    def surface_work(self) -> float:
        """Return the time of work on a surface by all photographs, relative to the usual capture's."""
        return float((self.views / USUAL_VIEWS * self.size) ** GROWTH)
