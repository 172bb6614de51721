"""The visual hull: the largest shape whose silhouettes fit the masks (Laurentini 1994), as a distance-like field."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from mgsr.data.camera import Camera
from mgsr.data.silhouettes import Silhouette
from mgsr.data.valid_mask import valid_at
from mgsr.errors import SceneError
from mgsr.parallel import map_ahead

# A voxel can be inside only if at least this share of the views shows it. No mask carves a region outside nearly all
# images, so it would remain as a false block.
MIN_SEEN = 0.25

# The field between voxel centres changes a little faster than distance (perspective, skewed pixels).
SLACK = 1.2


@dataclass(frozen=True)
class Hull:
    """A visual hull as a grid of approximate signed distances.

    field [R,R,R] float32 (x, y, z): the approximate signed distance to the hull's surface, positive inside. It is exact
    only near the surface and where enough views see it. Its samples are voxel centres.
    voxel: the spacing of the samples.
    origin [3]: the position of the first sample.
    """

    field: np.ndarray
    origin: np.ndarray
    voxel: float

    def reached(self) -> np.ndarray:
        """Return the centres [P,3] of the voxels that the hull reaches into, thin tips included."""
        centres: np.ndarray = np.argwhere(self.field > -self.voxel / 2) * self.voxel + self.origin
        return centres

    def box(self) -> np.ndarray:
        """Return the least and the largest corner [2,3] of the voxel centres inside; the hull must not be empty."""
        places = np.argwhere(self.field > 0) * self.voxel + self.origin
        return np.stack([places.min(axis=0), places.max(axis=0)])

    def values(self, points: np.ndarray) -> np.ndarray:
        """Return the field at points [P,3], trilinearly interpolated; far negative outside the grid."""
        place = ((points - self.origin) / self.voxel).T
        values: np.ndarray = ndimage.map_coordinates(self.field, place, order=1, mode="constant", cval=-1e3)
        return values


def carve(
    silhouettes: Sequence[Silhouette], center: np.ndarray, half: float, resolution: int = 128, dissent: int = 0
) -> Hull:
    """Carve the hull inside the cube center [3] +- half, from coarse to fine: only voxels near the surface are split.

    resolution: voxels per side, a multiple of 16; 64 and 128 start from 32. dissent: the number of views whose masks
    may exclude a point of the object.
    """
    size = resolution
    while size % 2 == 0 and size > 32:
        size //= 2
    corner = np.asarray(center, dtype=np.float64) - half
    active = np.stack(np.meshgrid(*[np.arange(size)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    field = np.empty((size,) * 3, dtype=np.float32)
    while True:
        voxel = 2 * half / size
        values, judged = signed_field(silhouettes, corner + (active + 0.5) * voxel, dissent)
        field[tuple(active.T)] = np.where(judged, values, -voxel)
        if size == resolution:
            return Hull(field, corner + voxel / 2, voxel)
        # A child's centre is a quarter of the diagonal away, and one more child must lie around the surface.
        near = np.abs(values) < SLACK * np.sqrt(3) * voxel * 0.75
        active = _children(active[near | ~judged])
        field = np.repeat(np.repeat(np.repeat(field, 2, 0), 2, 1), 2, 2)
        size *= 2


def cut_at(hull: Hull, plane: np.ndarray, margin: float = 0.0) -> Hull:
    """Cut off the part of a hull that lies more than a margin below a plane.

    plane [4]: the unit normal, which points up, and the offset, with normal . x + offset = 0, in the hull's frame.
    margin: in the hull's unit.
    """
    # Heights are linear, so the heights along the axes add up.
    axes = hull.origin + np.arange(len(hull.field))[:, None] * hull.voxel
    x, y, z = (axes[:, i] * plane[i] for i in range(3))
    heights = x[:, None, None] + y[None, :, None] + z[None, None, :] + plane[3]
    return replace(hull, field=np.minimum(hull.field, heights + margin).astype(np.float32))


def hull_surface(hull: Hull) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices [V,3] and outward faces [F,3] of the hull's surface. Raises SceneError if the hull is empty."""
    from skimage.measure import marching_cubes

    if not (hull.field > 0).any():
        raise SceneError("the masks of the training views have no common visual hull; run with masks=off")
    # A layer of outside values closes the surface where the grid ends.
    padded = np.pad(hull.field, 1, constant_values=-hull.voxel)
    vertices, faces, _, _ = marching_cubes(padded, 0.0, gradient_direction="ascent")
    return (vertices - 1) * hull.voxel + hull.origin, faces


def signed_field(
    silhouettes: Sequence[Silhouette], points: np.ndarray, dissent: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Return each point's smallest signed distance [P] float32, in world units, over the views that constrain it.

    dissent: the number of smaller distances that are skipped. Also returns whether enough views constrain each of the
    points [P,3], as [P] bool; other points count as outside.
    """
    lowest = np.full((dissent + 1, len(points)), np.inf, dtype=np.float32)  # sorted, the least first
    count = np.zeros(len(points), dtype=np.int32)
    for constrained, distance in map_ahead(lambda silhouette: view_field(silhouette, points), silhouettes, None):
        count += constrained
        keep_lowest(lowest, np.where(constrained, distance, np.inf).astype(np.float32))
    return lowest[dissent], count >= max(2 + dissent, MIN_SEEN * len(silhouettes))


def keep_lowest(lowest: np.ndarray, values: np.ndarray) -> None:
    """Insert values [P] into the lowest values so far [N,P], sorted with the least first; the largest falls out."""
    for row in lowest:
        larger = np.maximum(row, values)
        np.minimum(row, values, out=row)
        values = larger


def view_field(silhouette: Silhouette, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return whether a view constrains each point [P], and the signed distance [P] there, in world units.

    A view constrains the points that it sees. A view that shows the whole object also constrains all other points, as
    outside.
    """
    camera = silhouette.camera
    pixels, depth = camera.project(points)
    x, y = pixels.T
    constrained = (depth > 0) & (x > 0) & (x < camera.width) & (y > 0) & (y < camera.height)
    place = [y - 0.5, x - 0.5]
    distance = ndimage.map_coordinates(silhouette.distance, place, order=1, mode="nearest", output=np.float32)
    distance *= depth / np.sqrt(camera.K[0, 0] * camera.K[1, 1])
    if silhouette.whole:
        outside = ~constrained
        distance[outside] = np.minimum(distance[outside], 0)  # behind the camera it has the wrong sign
        distance[outside] -= _beyond(camera, points[outside], pixels[outside], depth[outside])
        return np.ones_like(constrained), distance
    if silhouette.valid_mask is not None:
        constrained[constrained] = valid_at(silhouette.valid_mask, pixels[constrained])
    return constrained, distance


def _beyond(camera: Camera, points: np.ndarray, pixels: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """Return the approximate distance of points [P,3] outside an image from its field of view, in world units."""
    over = np.maximum(np.maximum(-pixels, pixels - [camera.width, camera.height]), 0)
    before = np.linalg.norm(over / camera.K.diagonal()[:2], axis=1) * depth
    distances: np.ndarray = np.where(depth > 0, before, np.linalg.norm(points - camera.center, axis=1))
    return distances


def _children(parents: np.ndarray) -> np.ndarray:
    """Return the eight half-size cells [8P,3] of each cell [P,3], by their indices."""
    corners = np.stack(np.meshgrid(*[[0, 1]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    children: np.ndarray = (parents[:, None] * 2 + corners).reshape(-1, 3)
    return children
