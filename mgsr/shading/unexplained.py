"""The residual that paint and a mirrored environment map leave of the photographs, place by place on a surface.

Where a surface is right, each of its points has one brightness of its own in all photographs, and what it mirrors comes
from one environment map. Where it is wrong, other places come to lie behind one point from view to view. So of two
surfaces that are seen at the same pixel, the one that leaves less unexplained is the likelier there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mgsr.data.camera import Camera, pixel_size
from mgsr.data.scene import View
from mgsr.geometry.decimate import coarser
from mgsr.geometry.displace import edge_length, spread, umbrella
from mgsr.geometry.raycast import RayCaster
from mgsr.geometry.triangles import Triangles
from mgsr.shading.kinds import FRONTAL, MIRRORING_EDGE, Shot, mirrored_surroundings
from mgsr.shading.readings import Readings, linear_photographs
from mgsr.shading.surroundings import Surroundings

AROUND = 6.0  # pixels over which what is left of the readings is put together
FEWEST = 3  # readings of a point, or it tells nothing


@dataclass(frozen=True)
class Unexplained:
    """The photometric residual of a surface, vertices [V,3] and faces [F,3].

    variance [V]: of the readings around each vertex, in squared linear light, that is left once each point has its own
    brightness and what it mirrors, 0 where too few tell; ratio: the share of the readings' deviation that the
    environment map leaves on the whole surface.
    """

    vertices: np.ndarray
    faces: np.ndarray
    variance: np.ndarray
    ratio: float

    def seen_by(self, camera: Camera) -> np.ndarray:
        """Return the variance [H,W] of what the camera sees; 0 where it sees nothing, or too few readings tell."""
        hits = self._caster.cast(camera)
        corners = self.variance[self.faces[np.where(hits.mask, hits.face, 0)]]
        return np.asarray(np.where(hits.mask & (corners > 0).all(axis=-1), corners.mean(axis=-1), 0))

    @cached_property
    def _caster(self) -> RayCaster:
        return RayCaster(self.vertices, self.faces)


def leave_unexplained(
    surfaces: Sequence[Triangles], views: Sequence[View], threads: int | None = None
) -> list[Unexplained]:
    """Return the residual of each of several meshes, by the one environment map that explains its mesh best."""
    photographs, read = linear_photographs(views), []
    for vertices, faces in surfaces:
        pixel = pixel_size([view.camera for view in views], vertices.mean(axis=0))
        mesh = coarser(vertices, faces, MIRRORING_EDGE * pixel)
        readings, normals = Shot(photographs, pixel, threads).read(*mesh)
        surroundings = mirrored_surroundings(readings, normals)
        read.append((mesh, pixel, readings.frontal(FRONTAL), normals, surroundings))
    best = min((each[-1] for each in read), key=lambda surroundings: surroundings.ratio)
    return [
        Unexplained(*mesh, _pooled(*mesh, pixel, readings, _left(readings, normals, best)), own.ratio)
        for mesh, pixel, readings, normals, own in read
    ]


def _left(readings: Readings, normals: np.ndarray, surroundings: Surroundings) -> np.ndarray:
    """Return the readings' brightness [P,K] less what points with normals [P,3] mirror; 0 where unseen."""
    seen = readings.weights > 0
    owners = np.nonzero(seen)[0]
    left = np.zeros(seen.shape)
    left[seen] = readings.brightness[seen] - surroundings.mirrored(normals[owners], readings.towards[seen])
    return left


def _pooled(vertices: np.ndarray, faces: np.ndarray, pixel: float, readings: Readings, left: np.ndarray) -> np.ndarray:
    """Return the variance [V] of the residuals [V,K] about each point's mean, averaged over AROUND pixels."""
    weights = np.where(readings.counts[:, None] >= FEWEST, readings.weights, 0)
    total = weights.sum(axis=1)
    means = (weights * left).sum(axis=1) / np.maximum(total, 1e-9)
    squares = (weights * (left - means[:, None]) ** 2).sum(axis=1)
    reach = AROUND * pixel / edge_length(vertices, faces)
    sums = spread(np.stack([squares, total], axis=1), umbrella(faces, len(vertices)), reach)
    return np.asarray(sums[:, 0] / np.maximum(sums[:, 1], 1e-9))
