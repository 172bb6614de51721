"""The shape of the example capture: a trefoil knot standing on a small foot, as an implicit surface with a pattern.

Everything is written in the shape's own units first and scaled to a bounding sphere of radius 1 at the end, z up.
"""

from __future__ import annotations

from dataclasses import dataclass

import fast_simplification
import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from skimage.measure import marching_cubes

Array = NDArray[np.float64]

CURVE_SAMPLES = 4000
# Farther than this from the curve the tube's distance does not matter to the surface; the search stops there.
REACH = 0.6
FOOT_CENTER = np.array([0.0, 0.0, -1.02])
FOOT_RADII = np.array([0.56, 0.56, 0.17])
# Width of the soft blend between knot and foot.
BLEND = 0.12

# Along the knot, sRGB: coral, amber, teal and blue, then coral again.
PALETTE = np.array([[0.80, 0.24, 0.22], [0.84, 0.55, 0.15], [0.10, 0.48, 0.43], [0.18, 0.31, 0.64]])
CREAM = np.array([0.84, 0.78, 0.66])
INK = np.array([0.16, 0.17, 0.28])


@dataclass(frozen=True)
class Surface:
    """A closed triangle mesh, outwards oriented: vertices [V,3], unit normals [V,3], sRGB colors [V,3], faces [F,3]."""

    vertices: Array
    normals: Array
    colors: Array
    faces: NDArray[np.int64]


@dataclass(frozen=True)
class NearTube:
    """Where points lie relative to the tube: curve parameter t [N], angle around it [N], signed distance [N]."""

    t: Array
    angle: Array
    distance: Array


def knot_curve(t: Array) -> Array:
    """Trefoil knot [N,3] at t in [0, 2 pi), standing in the xz plane and a little turned."""
    return np.stack(
        [
            (np.sin(t) + 2 * np.sin(2 * t)) / 3,
            0.48 * np.sin(3 * t),
            (np.cos(t) - 2 * np.cos(2 * t)) / 3,
        ],
        axis=-1,
    )


def knot_tangent(t: Array) -> Array:
    """Return d knot_curve / dt, [N,3]."""
    return np.stack(
        [
            (np.cos(t) + 4 * np.cos(2 * t)) / 3,
            1.44 * np.cos(3 * t),
            (-np.sin(t) + 4 * np.sin(2 * t)) / 3,
        ],
        axis=-1,
    )


def knot_bend(t: Array) -> Array:
    """Return d knot_tangent / dt, [N,3]."""
    return np.stack(
        [
            (-np.sin(t) - 8 * np.sin(2 * t)) / 3,
            -4.32 * np.sin(3 * t),
            (-np.cos(t) + 8 * np.cos(2 * t)) / 3,
        ],
        axis=-1,
    )


def tube_radius(t: Array) -> Array:
    """Radius of the tube [N]: six soft swellings, no two alike."""
    return 0.18 + 0.03 * np.cos(6 * t + 0.5) + 0.02 * np.cos(t)


class KnotShape:
    """The implicit surface `distance(points) = 0`, negative inside, and the colour of its points."""

    def __init__(self) -> None:
        self._t = np.linspace(0, 2 * np.pi, CURVE_SAMPLES, endpoint=False)
        self._tree = cKDTree(knot_curve(self._t))

    def near_tube(self, points: Array, reach: float = np.inf) -> NearTube:
        """Find the tube around each of points [N,3]; distance is `reach` for those farther than that from the curve."""
        _, index = self._tree.query(points, distance_upper_bound=reach)
        found = index < CURVE_SAMPLES
        t = self._t[np.where(found, index, 0)]
        # Newton steps to the nearest point: the samples of the curve would show as specks in the gloss.
        for _ in range(2):
            offset, tangent = points - knot_curve(t), knot_tangent(t)
            bend = np.sum(offset * knot_bend(t), axis=1)
            # Inside the bend's circle the nearest point is a minimum, and the denominator is positive.
            speed = np.sum(tangent**2, axis=1)
            t = t + np.sum(offset * tangent, axis=1) / np.maximum(speed - bend, 0.3 * speed)
        offset = points - knot_curve(t)
        distance = np.where(found, np.linalg.norm(offset, axis=1) - tube_radius(t), reach)
        return NearTube(t, _angle_around(offset, knot_tangent(t)), distance)

    def distance(self, points: Array, reach: float = np.inf) -> Array:
        """Approximate signed distance [N] of points [N,3]; exact in sign, smooth near the surface."""
        return smooth_min(self.near_tube(points, reach).distance, foot_distance(points), BLEND)

    def normals(self, points: Array) -> Array:
        """Return unit outward normals [N,3] at surface points [N,3], by central differences."""
        step = 1e-4 * np.eye(3)
        gradient = np.stack([self.distance(points + s) - self.distance(points - s) for s in step], axis=-1)
        unit: Array = gradient / np.linalg.norm(gradient, axis=1, keepdims=True)
        return unit

    def snapped(self, points: Array) -> Array:
        """Points [N,3] near the surface moved onto it, along the normal."""
        for _ in range(2):
            points = points - self.distance(points)[:, None] * self.normals(points)
        return points

    def colors(self, points: Array) -> Array:
        """Return sRGB colours [N,3] in 0..1: hues along the knot with spiral stripes and dots, rings on the foot."""
        tube = self.near_tube(points)
        on_foot = _step(tube.distance - foot_distance(points), 0.02)[:, None]
        return on_foot * _foot_colors(points) + (1 - on_foot) * _knot_colors(tube)

    def mesh(self, cell: float) -> Surface:
        """Extract the surface by marching cubes with cells of `cell`, in the shape's units; vertices lie on it."""
        low, high = np.array([-1.25, -0.8, -1.3]), np.array([1.25, 0.8, 1.35])
        axes = [np.arange(a, b, cell) for a, b in zip(low, high, strict=True)]
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
        values = self.distance(grid.reshape(-1, 3), REACH).reshape(grid.shape[:3])
        vertices, faces, _, _ = marching_cubes(values, 0.0, spacing=(cell,) * 3, gradient_direction="ascent")
        return self.surface(vertices + low, faces)

    def surface(self, vertices: Array, faces: NDArray[np.int64]) -> Surface:
        """Return the Surface of these faces, its vertices snapped; normals and colours come from the implicit shape."""
        # As it is: merging vertices that came to lie together would pinch the surface.
        mesh = trimesh.Trimesh(self.snapped(vertices.astype(np.float64)), faces, process=False)
        if mesh.volume < 0:
            mesh.invert()
        points = np.asarray(mesh.vertices)
        return Surface(points, self.normals(points), self.colors(points), np.asarray(mesh.faces))

    def simplified(self, surface: Surface, faces: int) -> Surface:
        """`surface` with about `faces` faces."""
        vertices, triangles = fast_simplification.simplify(
            surface.vertices.astype(np.float32), surface.faces.astype(np.int32), target_count=faces
        )
        return self.surface(vertices, triangles)


def foot_distance(points: Array) -> Array:
    """Approximate signed distance [N] to the foot, a flat ellipsoid."""
    scaled = (points - FOOT_CENTER) / FOOT_RADII
    norm = np.maximum(np.linalg.norm(scaled, axis=1), 1e-9)
    distances: Array = norm * (norm - 1) / np.maximum(np.linalg.norm(scaled / FOOT_RADII, axis=1), 1e-9)
    return distances


def smooth_min(a: Array, b: Array, width: float) -> Array:
    """Return the smaller of a and b, blended smoothly where they differ by less than `width`."""
    h = np.maximum(width - np.abs(a - b), 0) / width
    return np.minimum(a, b) - h**2 * width / 4


def normalised(surface: Surface, like: Surface) -> Surface:
    """`surface` in the frame where the bounding sphere of `like` has centre 0 and radius 1."""
    center, radius = bounding_sphere(like.vertices)
    return Surface((surface.vertices - center) / radius, surface.normals, surface.colors, surface.faces)


def bounding_sphere(points: Array) -> tuple[Array, float]:
    """Centre and radius of the sphere around points [N,3] about the middle of their box."""
    center = (points.min(axis=0) + points.max(axis=0)) / 2
    return center, float(np.linalg.norm(points - center, axis=1).max())


def _angle_around(offset: Array, tangent: Array) -> Array:
    """Angle [N] of `offset` around the curve, from the side that faces +y."""
    side = np.cross(tangent, [0.0, 1.0, 0.0])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    angles: Array = np.arctan2(np.sum(offset * side, axis=1), offset[:, 1])
    return angles


def _step(x: Array, width: float) -> Array:
    """0 below, 1 above 0, soft over +-width."""
    s = np.clip(0.5 + x / (2 * width), 0, 1)
    return s * s * (3 - 2 * s)


def _knot_colors(tube: NearTube) -> Array:
    place = tube.t / (2 * np.pi) * len(PALETTE)
    index = np.floor(place).astype(int)
    into = _step(place - index - 0.5, 0.5)[:, None]
    color = (1 - into) * PALETTE[index % len(PALETTE)] + into * PALETTE[(index + 1) % len(PALETTE)]
    stripe = _step(np.cos(3 * tube.angle + 12 * tube.t) - 0.72, 0.12)[:, None]
    dots = _step(np.cos(3 * tube.angle + 12 * tube.t + np.pi) * np.cos(24 * tube.t) - 0.62, 0.1)[:, None]
    color = (1 - stripe) * color + stripe * CREAM
    dotted: Array = (1 - dots) * color + dots * (0.35 * color + 0.65 * INK)
    return dotted


def _foot_colors(points: Array) -> Array:
    radius = np.hypot(points[:, 0], points[:, 1])
    around = np.arctan2(points[:, 1], points[:, 0])
    petals = _step(np.cos(10 * around) * np.cos(30 * radius), 0.15)[:, None]
    colors: Array = petals * CREAM + (1 - petals) * (0.55 * INK + 0.45 * PALETTE[3])
    return colors
