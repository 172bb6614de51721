"""Shape from shading: a surface is fitted to the normals that explain the photographs' shading.

Normals determine the small-scale shape best, and positions the large-scale shape (Nehab and others 2005). The masks'
contours hold the surface where they touch it. If no light model explains the photographs, the surface stays.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from mgsr.config.expert import BilateralOptions, ContourSearchOptions, ShadingOptions, ShadingPass
from mgsr.geometry.bilateral_filter import bilateral_normal_filter
from mgsr.geometry.contours import SilhouetteContour, contour_gaps
from mgsr.geometry.decimate import coarser
from mgsr.geometry.displace import diffuse, integrate_normals
from mgsr.geometry.mesh import Mesh
from mgsr.shading.light_estimate import LightEstimate
from mgsr.shading.light_kind import LightKind
from mgsr.shading.photo_set import PhotoSet
from mgsr.shading.target_normals import TargetNormals


def shape_from_shading(
    mesh: Mesh,
    photos: PhotoSet,
    estimate: LightEstimate,
    passes: Mapping[LightKind, Sequence[ShadingPass]],
    progress: Callable[[float], None] = lambda done: None,
    go_on: Callable[[], bool] = lambda: True,
    options: ShadingOptions = ShadingOptions(),
) -> Mesh:
    """Move a mesh so that its shading under the estimated light explains the photographs.

    photos: the photographs; their silhouette contours, if any, hold the surface. estimate: the light; its model is
    refined with the mesh. passes: the passes for each kind of light; without any, the mesh stays. progress: receives
    the share of the rounds that are done, 0..1, after each round. go_on: called before every round; no rounds follow
    once it returns False.
    """
    if estimate.model is None:
        return mesh
    pixel, chosen, done = photos.pixel_on(mesh), passes.get(estimate.kind, ()), 0
    rounds = sum(each.rounds for each in chosen)
    for each in chosen:
        mesh = _bilateral_filtered(mesh, each.bilateral_angle, options.bilateral)
        before = coarser(mesh, each.edge * pixel, options.max_faces)
        fine = _FineMesh(mesh, before, before.prolongation(mesh.vertices), photos.contours, options.contours)
        after = before
        for _ in range(each.rounds):
            if not go_on():
                break
            after = _bend(after, fine, estimate.model.explain(after), each.reach * pixel, pixel, options)
            done += 1
            progress(done / rounds)
        mesh = _bilateral_filtered(fine.moved_with(after), each.bilateral_angle, options.bilateral)
    return mesh


@dataclass(frozen=True)
class _FineMesh:
    """The full mesh that follows a coarse one, and the masks' contours that hold it.

    mesh, before: the full and the coarse mesh before any moves. prolongation [W,V]: from the coarse mesh's V vertices
    to the full mesh's W. contours: they are compared with the full mesh, as the coarse one cuts corners. search:
    the options of that comparison.
    """

    mesh: Mesh
    before: Mesh
    prolongation: sparse.csr_matrix
    contours: Sequence[SilhouetteContour]
    search: ContourSearchOptions

    def moved_with(self, after: Mesh) -> Mesh:
        """Return the full mesh after the coarse one has moved to `after`."""
        return self.mesh.moved(self.mesh.vertices + self.prolongation @ (after.vertices - self.before.vertices))

    def gaps(self, after: Mesh) -> tuple[np.ndarray, np.ndarray]:
        """Return both arrays [V] of `contour_gaps` for the coarse mesh's vertices after it has moved to `after`."""
        gaps, touched = contour_gaps(self.moved_with(after), self.contours, self.search)
        sums, counts = self.prolongation.T @ (gaps * touched), self.prolongation.T @ touched
        return sums / np.maximum(counts, 1e-9), counts


def _bend(
    mesh: Mesh, fine: _FineMesh, target: TargetNormals, reach: float, pixel: float, options: ShadingOptions
) -> Mesh:
    """Fit the coarse mesh to the target normals, the contours and its own positions.

    reach: the wavelength above which shape stays, in the scene's unit. pixel: a pixel's size, in the same unit.
    """
    offsets, touched = fine.gaps(mesh)
    held, own, contour = np.minimum(touched, 1), options.prior_weight, options.contour_weight
    offsets = _mean_around(offsets, held, mesh.laplacian, options.contour_smoothing * pixel / mesh.edge_length)
    strength = own * (reach / (2 * np.pi * mesh.edge_length)) ** 2
    moves = integrate_normals(
        mesh,
        target.normals,
        target.confidence,
        strength,
        prior_weight=own + contour * held,
        prior=offsets * contour * held / (contour * held + own),
    )
    return mesh.moved(mesh.vertices + moves[:, None] * mesh.double_normals)


def _bilateral_filtered(mesh: Mesh, angle: float, options: BilateralOptions) -> Mesh:
    return bilateral_normal_filter(mesh, angle, options) if angle else mesh


def _mean_around(values: np.ndarray, weights: np.ndarray, laplacian: sparse.csr_matrix, reach: float) -> np.ndarray:
    """Return the means [V] of values [V], weighted by weights [V], over about `reach` edges around each vertex."""
    sums = diffuse(np.stack([values * weights, weights], axis=1), laplacian, reach)
    means: np.ndarray = sums[:, 0] / np.maximum(sums[:, 1], 1e-9)
    return means
