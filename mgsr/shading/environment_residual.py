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
from mgsr.geometry.displace import diffuse, edge_length, uniform_laplacian
from mgsr.geometry.raycast import RayCaster
from mgsr.geometry.triangles import Triangles
from mgsr.shading.environment_fit import FittedEnvironmentMap
from mgsr.shading.light_models import ENVIRONMENT_EDGE, FRONTAL, Shot, fit_mirrored_environment
from mgsr.shading.observations import Observations, linear_photographs

AROUND = 6.0  # pixels over which what is left of the readings is put together
FEWEST = 3  # readings of a point, or it tells nothing


@dataclass(frozen=True)
class EnvironmentResidual:
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


def environment_residuals(
    surfaces: Sequence[Triangles], views: Sequence[View], threads: int | None = None
) -> list[EnvironmentResidual]:
    """Return the residual of each of several meshes, by the one environment map that explains its mesh best."""
    photographs, read = linear_photographs(views), []
    for vertices, faces in surfaces:
        pixel = pixel_size([view.camera for view in views], vertices.mean(axis=0))
        mesh = coarser(vertices, faces, ENVIRONMENT_EDGE * pixel)
        observations, normals = Shot(photographs, pixel, threads).read(*mesh)
        environment = fit_mirrored_environment(observations, normals)
        read.append((mesh, pixel, observations.frontal(FRONTAL), normals, environment))
    best = min((each[-1] for each in read), key=lambda environment: environment.ratio)
    return [
        EnvironmentResidual(
            *mesh, _pooled(*mesh, pixel, observations, _residual(observations, normals, best)), own.ratio
        )
        for mesh, pixel, observations, normals, own in read
    ]


def _residual(observations: Observations, normals: np.ndarray, environment: FittedEnvironmentMap) -> np.ndarray:
    """Return the readings' brightness [P,K] less what points with normals [P,3] mirror; 0 where unseen."""
    seen = observations.weights > 0
    owners = np.nonzero(seen)[0]
    residual = np.zeros(seen.shape)
    residual[seen] = observations.brightness[seen] - environment.mirrored(
        normals[owners], observations.view_directions[seen]
    )
    return residual


def _pooled(
    vertices: np.ndarray, faces: np.ndarray, pixel: float, observations: Observations, residual: np.ndarray
) -> np.ndarray:
    """Return the variance [V] of the residuals [V,K] about each point's mean, averaged over AROUND pixels."""
    weights = np.where(observations.counts[:, None] >= FEWEST, observations.weights, 0)
    total = weights.sum(axis=1)
    means = (weights * residual).sum(axis=1) / np.maximum(total, 1e-9)
    squares = (weights * (residual - means[:, None]) ** 2).sum(axis=1)
    reach = AROUND * pixel / edge_length(vertices, faces)
    sums = diffuse(np.stack([squares, total], axis=1), uniform_laplacian(faces, len(vertices)), reach)
    return np.asarray(sums[:, 0] / np.maximum(sums[:, 1], 1e-9))
