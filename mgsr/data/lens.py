"""Lens models: the projection of rays with each kind of distortion.

Every lens maps a ray (x, y, 1) to a point (x, y) of the normalised image plane; K then maps it to pixels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

# The formats' names of panoramic cameras, in lower case.
PANORAMAS = ("equirectangular", "spherical")
PANORAMA_CURE = (
    "a panorama has no pinhole camera; cut perspective photographs out of it with COLMAP's panorama_sfm.py or "
    "`ns-process-data images --camera-type equirectangular`, and use those with their cameras"
)

Coordinates = tuple[np.ndarray, np.ndarray]


class AnyLens(Protocol):
    """The interface of all lenses. They are frozen, so that equal lenses share cached results."""

    @property
    def flat(self) -> bool:
        """Return whether this lens changes nothing."""

    def distort(self, x: np.ndarray, y: np.ndarray) -> Coordinates:
        """Project the rays (x, y, 1) through the lens; NaN for rays that it can't show.

        x, y [...]: arrays that broadcast. The results lie on the normalised image plane, as K expects.
        """


@dataclass(frozen=True)
class Lens:
    """Brown's polynomial in OpenCV's form, with further terms for some formats.

    k1, k2, higher: the factors of r^2, r^4, r^6 and so on.
    p1, p2: the tangential factors.
    divisor: the factors of r^2, r^4, r^6 in the denominator (OpenCV's k4, k5, k6).
    prism: OpenCV's s1..s4.
    skew: the factor by which y is added to x at the end, divided by the focal length in x.
    fisheye: whether the polynomial acts on the ray's angle (Kannala and Brandt 2006) instead of its tangent.
    """

    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    higher: tuple[float, ...] = ()
    divisor: tuple[float, ...] = ()
    prism: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    skew: float = 0.0
    fisheye: bool = False

    @property
    def flat(self) -> bool:
        """Return whether this lens changes nothing."""
        terms = (self.k1, self.k2, self.p1, self.p2, *self.higher, *self.divisor, *self.prism, self.skew)
        return not self.fisheye and not any(terms)

    def distort(self, x: np.ndarray, y: np.ndarray) -> Coordinates:
        """Return the distorted coordinates [...] of the rays (x, y, 1), by OpenCV's model.

        Source: OpenCV's calib3d documentation, "Detailed Description"; for fisheyes its section "Fisheye camera model".
        """
        if self.fisheye:
            x, y = _by_angle(x, y)
        r2 = x * x + y * y
        radial = 1 + _polynomial(r2, (self.k1, self.k2, *self.higher))
        if any(self.divisor):
            radial = radial / (1 + _polynomial(r2, self.divisor))
        dx = 2 * self.p1 * x * y + self.p2 * (r2 + 2 * x * x)
        dy = self.p1 * (r2 + 2 * y * y) + 2 * self.p2 * x * y
        if any(self.prism):
            dx = dx + _polynomial(r2, self.prism[:2])
            dy = dy + _polynomial(r2, self.prism[2:])
        bent_x, bent_y = x * radial + dx, y * radial + dy
        return (bent_x + self.skew * bent_y, bent_y) if self.skew else (bent_x, bent_y)


@dataclass(frozen=True)
class FieldOfViewLens:
    """The field-of-view model, with one angle `omega`, radians (Devernay and Faugeras 2001)."""

    omega: float
    flat: bool = False

    def distort(self, x: np.ndarray, y: np.ndarray) -> Coordinates:
        """Map the radius r of the rays (x, y, 1), x and y [...], to atan(2 r tan(omega / 2)) / omega."""
        r = np.maximum(np.hypot(x, y), 1e-12)
        factor = np.arctan(2 * r * math.tan(self.omega / 2)) / (self.omega * r)
        return x * factor, y * factor


@dataclass(frozen=True)
class DivisionLens:
    """The division model, with one factor (Fitzgibbon 2001).

    undistorted = distorted / (1 + k r^2), with the distorted radius r.
    """

    k: float

    @property
    def flat(self) -> bool:
        """Return whether this lens changes nothing."""
        return self.k == 0

    def distort(self, x: np.ndarray, y: np.ndarray) -> Coordinates:
        """Return the distorted coordinates [...], from the root of a quadratic equation for the radius."""
        with np.errstate(invalid="ignore"):
            factor = 2 / (1 + np.sqrt(1 - 4 * self.k * (x * x + y * y)))
        return x * factor, y * factor


@dataclass(frozen=True)
class InverseRadialLens:
    """An inverse radial model with one factor: VisualSFM's "measurement distortion" (Wu 2011).

    undistorted = distorted (1 + k r^2), with the distorted radius r.
    """

    k: float

    @property
    def flat(self) -> bool:
        """Return whether this lens changes nothing."""
        return self.k == 0

    def distort(self, x: np.ndarray, y: np.ndarray) -> Coordinates:
        """Return the distorted coordinates [...], from the root of a cubic equation for the radius.

        Of its roots, the distorted radius is the one that tends to r as k goes to 0.

        A negative k has a largest undistorted radius; rays beyond it have no root and become NaN.
        """
        if self.flat:
            return x, y
        r = np.maximum(np.hypot(x, y), 1e-12)
        s = math.sqrt(3 * abs(self.k))
        with np.errstate(invalid="ignore"):
            angle = (np.arcsinh(1.5 * s * r) if self.k > 0 else np.arcsin(1.5 * s * r)) / 3
        factor = 2 / (s * r) * (np.sinh(angle) if self.k > 0 else np.sin(angle))
        return x * factor, y * factor


@dataclass(frozen=True)
class UnifiedLens:
    """The enhanced unified camera model (Khomutenko, Garcia and Martinet 2016)."""

    alpha: float
    beta: float

    @property
    def flat(self) -> bool:
        """Return whether this lens changes nothing."""
        return self.alpha == 0

    def distort(self, x: np.ndarray, y: np.ndarray) -> Coordinates:
        """Divide the ray by alpha d + (1 - alpha) z: d [...] is its distance on the ellipsoid, z its depth."""
        factor = 1 / (self.alpha * np.sqrt(self.beta * (x * x + y * y) + 1) + 1 - self.alpha)
        return x * factor, y * factor


@dataclass(frozen=True)
class AriaLens:
    """A fisheye with six radial, two tangential and four prism terms (Project Aria's "Fisheye624")."""

    radial: tuple[float, ...]
    tangential: tuple[float, float]
    prism: tuple[float, float, float, float]
    flat: bool = False

    def distort(self, x: np.ndarray, y: np.ndarray) -> Coordinates:
        """Return the distorted coordinates [...]: radial terms act on the ray's angle, the others on the result."""
        x, y = _by_angle(x, y)
        factor = 1 + _polynomial(x * x + y * y, self.radial)
        x, y = x * factor, y * factor
        r2 = x * x + y * y
        across = 2 * (x * self.tangential[0] + y * self.tangential[1])
        dx = across * x + self.tangential[0] * r2 + _polynomial(r2, self.prism[:2])
        dy = across * y + self.tangential[1] * r2 + _polynomial(r2, self.prism[2:])
        return x + dx, y + dy


def _by_angle(x: np.ndarray, y: np.ndarray) -> Coordinates:
    """Return rays scaled so that their length is their angle to the axis, radians."""
    r = np.maximum(np.hypot(x, y), 1e-12)
    factor = np.arctan(r) / r
    return x * factor, y * factor


def _polynomial(r2: np.ndarray, factors: tuple[float, ...]) -> np.ndarray:
    """Return factors[0] r^2 + factors[1] r^4 + ..., by Horner's rule."""
    used = len(factors)
    while used > 1 and factors[used - 1] == 0:
        used -= 1
    total: np.ndarray | float = 0.0
    for factor in reversed(factors[:used]):
        total = (total + factor) * r2
    return np.asarray(total)
