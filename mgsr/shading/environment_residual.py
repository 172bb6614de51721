"""The residual that paint and a mirrored environment map leave of the photographs, place by place on a surface.

Where a surface is right, each of its points has one brightness of its own in all photographs, and what it mirrors comes
from one environment map. Where it is wrong, other places come to lie behind one point from view to view. So of two
surfaces that are seen at the same pixel, the one that leaves less unexplained is the likelier there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mgsr.data.camera import Camera
from mgsr.geometry.decimate import coarser
from mgsr.geometry.displace import diffuse
from mgsr.geometry.mesh import Mesh
from mgsr.shading.environment_fit import FittedEnvironmentMap
from mgsr.shading.light_models import ENVIRONMENT_EDGE, FRONTAL, fit_mirrored_environment
from mgsr.shading.observations import Observations
from mgsr.shading.photo_set import Observer, PhotoSet

AROUND = 6.0  # pixels over which residuals are averaged
FEWEST = 3  # observations of a point, or it tells nothing


@dataclass(frozen=True)
class EnvironmentResidual:
    """The photometric residual of a mesh under a mirrored environment map.

    variance [V]: of the observations around each vertex, in squared linear light, that is left once each point has its
    own brightness and what it mirrors, 0 where too few tell; ratio: the share of the observations' deviation that the
    environment map leaves on the whole surface.
    """

    mesh: Mesh
    variance: np.ndarray
    ratio: float

    def seen_by(self, camera: Camera) -> np.ndarray:
        """Return the variance [H,W] of what the camera sees; 0 where it sees nothing, or too few observations tell."""
        hits = self.mesh.caster.cast(camera)
        corners = self.variance[self.mesh.faces[np.where(hits.mask, hits.face, 0)]]
        return np.asarray(np.where(hits.mask & (corners > 0).all(axis=-1), corners.mean(axis=-1), 0))


def environment_residuals(meshes: Sequence[Mesh], photos: PhotoSet) -> list[EnvironmentResidual]:
    """Return the residual of each of several meshes, by the one environment map that explains its mesh best."""
    read = []
    for mesh in meshes:
        pixel = photos.pixel_on(mesh)
        coarse = coarser(mesh, ENVIRONMENT_EDGE * pixel)
        observations = Observer(photos.linear, pixel, photos.threads).observe(coarse)
        environment = fit_mirrored_environment(observations, coarse.double_normals)
        read.append((coarse, pixel, observations.frontal(FRONTAL), environment))
    best = min((each[-1] for each in read), key=lambda environment: environment.ratio)
    return [
        EnvironmentResidual(
            mesh, _pooled(mesh, pixel, observations, _residual(observations, mesh.double_normals, best)), own.ratio
        )
        for mesh, pixel, observations, own in read
    ]


def _residual(observations: Observations, normals: np.ndarray, environment: FittedEnvironmentMap) -> np.ndarray:
    """Return the observations' brightness [P,K] less what points with normals [P,3] mirror; 0 where unseen."""
    seen = observations.weights > 0
    owners = np.nonzero(seen)[0]
    residual = np.zeros(seen.shape)
    residual[seen] = observations.brightness[seen] - environment.mirrored(
        normals[owners], observations.view_directions[seen]
    )
    return residual


def _pooled(mesh: Mesh, pixel: float, observations: Observations, residual: np.ndarray) -> np.ndarray:
    """Return the variance [V] of the residuals [V,K] about each point's mean, averaged over AROUND pixels."""
    weights = np.where(observations.counts[:, None] >= FEWEST, observations.weights, 0)
    total = weights.sum(axis=1)
    means = (weights * residual).sum(axis=1) / np.maximum(total, 1e-9)
    squares = (weights * (residual - means[:, None]) ** 2).sum(axis=1)
    reach = AROUND * pixel / mesh.edge_length
    sums = diffuse(np.stack([squares, total], axis=1), mesh.laplacian, reach)
    return np.asarray(sums[:, 0] / np.maximum(sums[:, 1], 1e-9))
