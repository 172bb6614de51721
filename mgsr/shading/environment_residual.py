"""The photometric residual of a surface under diffuse paint and a mirrored environment map.

On a correct surface, each point has the same diffuse brightness in all photographs, and its reflections come from one
environment map. On a wrong surface, a point shows a different place in each view. So of two surfaces at the same pixel,
the one with the lower residual is more likely.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mgsr.config.expert import EnvironmentOptions, EnvironmentResidualOptions
from mgsr.data.camera import Camera
from mgsr.geometry.displace import diffuse
from mgsr.geometry.mesh import Mesh
from mgsr.shading.environment_fit import FittedEnvironmentMap
from mgsr.shading.light_models import fit_mirrored_environment
from mgsr.shading.observations import Observations
from mgsr.shading.photo_set import PhotoSet


@dataclass(frozen=True)
class EnvironmentResidual:
    """The photometric residual of a mesh under a mirrored environment map.

    variance [V]: the residual variance around each vertex after the diffuse and the mirrored term, in squared linear
    light; 0 where observations are too few.
    ratio: the share of the observations' deviation on the whole surface that the environment map does not explain.
    """

    mesh: Mesh
    variance: np.ndarray
    ratio: float

    def seen_by(self, camera: Camera) -> np.ndarray:
        """Return the residual variance [H,W] at each pixel of a camera; 0 without surface or enough observations."""
        hits = self.mesh.caster.cast(camera)
        corners = self.variance[self.mesh.faces[np.where(hits.mask, hits.face, 0)]]
        return np.asarray(np.where(hits.mask & (corners > 0).all(axis=-1), corners.mean(axis=-1), 0))


def environment_residuals(
    meshes: Sequence[Mesh], photos: PhotoSet, options: EnvironmentOptions = EnvironmentOptions()
) -> list[EnvironmentResidual]:
    """Return each mesh's residual; all variances use one map, the map with the least ratio on its own mesh."""
    read = []
    for mesh in meshes:
        observer = photos.observer(photos.pixel_on(mesh))
        coarse = observer.coarser(mesh, options.edge, options.max_faces)
        observations = observer.observe(coarse)
        environment = fit_mirrored_environment(observations, coarse.double_normals, options)
        read.append((coarse, observer.pixel, observations.frontal(options.min_cosine), environment))
    best = min((each[-1] for each in read), key=lambda environment: environment.ratio)
    found = []
    for mesh, pixel, observations, own in read:
        residual = _residual(observations, mesh.double_normals, best)
        found.append(
            EnvironmentResidual(mesh, _pooled(mesh, pixel, observations, residual, options.residual), own.ratio)
        )
    return found


def _residual(observations: Observations, normals: np.ndarray, environment: FittedEnvironmentMap) -> np.ndarray:
    """Return the brightness [P,K] minus the light that points with unit normals [P,3] mirror; 0 where not visible."""
    seen = observations.weights > 0
    owners = np.nonzero(seen)[0]
    residual = np.zeros(seen.shape)
    residual[seen] = observations.brightness[seen] - environment.mirrored(
        normals[owners], observations.view_directions[seen]
    )
    return residual


def _pooled(
    mesh: Mesh,
    pixel: float,
    observations: Observations,
    residual: np.ndarray,
    options: EnvironmentResidualOptions,
) -> np.ndarray:
    """Return the variance [V] of residuals [V,K] about each vertex's mean, averaged over some pixels."""
    weights = np.where(observations.counts[:, None] >= options.min_observations, observations.weights, 0)
    total = weights.sum(axis=1)
    means = (weights * residual).sum(axis=1) / np.maximum(total, 1e-9)
    squares = (weights * (residual - means[:, None]) ** 2).sum(axis=1)
    reach = options.averaged * pixel / mesh.edge_length
    sums = diffuse(np.stack([squares, total], axis=1), mesh.laplacian, reach)
    return np.asarray(sums[:, 0] / np.maximum(sums[:, 1], 1e-9))
