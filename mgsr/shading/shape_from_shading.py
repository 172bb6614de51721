"""Shape from shading: a surface is bent to the normals that explain the photographs' shading.

Normals know the small shape best and positions the large (Nehab and others 2005), and the masks' contours hold the
surface where they touch it. Where no light model explains the photographs, the surface stays.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from mgsr.geometry.bilateral_filter import bilateral_normal_filter
from mgsr.geometry.contours import SilhouetteContour, contour_gaps
from mgsr.geometry.decimate import coarser
from mgsr.geometry.displace import diffuse, integrate_normals
from mgsr.geometry.mesh import Mesh
from mgsr.shading.light_estimate import LightEstimate, LightKind
from mgsr.shading.photo_set import PhotoSet
from mgsr.shading.target_normals import TargetNormals


@dataclass(frozen=True)
class ShadingOptions:
    """Weights that hold the surface while its normals are integrated; pixels are those on the surface."""

    contour_weight: float = 10.0  # of the place of a vertex that a contour touches
    prior_weight: float = 0.05  # of the place of any other
    contour_smoothing: float = 1.5  # pixels over which the contours' displacements are smoothed


@dataclass(frozen=True)
class ShadingPass:
    """Rounds of reading the photographs and bending the surface, with edges of about `edge` pixels.

    Shape larger than `reach` pixels stays as it is, except where contours move it. fairing: degrees; noise up to this
    is smoothed before and after the rounds (`bilateral_normal_filter`); 0: none.
    """

    edge: float
    rounds: int
    reach: float
    fairing: float = 0.0


def shape_from_shading(
    mesh: Mesh,
    photos: PhotoSet,
    estimate: LightEstimate,
    passes: Mapping[LightKind, Sequence[ShadingPass]],
    progress: Callable[[float], None] = lambda done: None,
    go_on: Callable[[], bool] = lambda: True,
    options: ShadingOptions = ShadingOptions(),
) -> Mesh:
    """Return the mesh moved so that its shading explains the photographs under the estimated light.

    photos: their silhouette contours hold the surface, where there are masks. estimate: its model is refined on the
    way. passes: how each light bends the surface; a light without any bends nothing. go_on: asked before every round;
    once it says no, no more rounds follow. progress: told after each round of the share of the rounds that are done.
    """
    if estimate.model is None:
        return mesh
    pixel, chosen, done = photos.pixel_on(mesh), passes.get(estimate.kind, ()), 0
    rounds = sum(each.rounds for each in chosen)
    for each in chosen:
        mesh = _fair(mesh, each.fairing)
        before = coarser(mesh, each.edge * pixel)
        fine = _FineMesh(mesh, before, before.prolongation(mesh.vertices), photos.contours)
        after = before
        for _ in range(each.rounds):
            if not go_on():
                break
            after = _bend(after, fine, estimate.model.explain(after), each.reach * pixel, pixel, options)
            done += 1
            progress(done / rounds)
        mesh = _fair(fine.moved_with(after), each.fairing)
    return mesh


@dataclass(frozen=True)
class _FineMesh:
    """The full mesh that follows a coarser one, and the contours that it is held against.

    mesh, before: both before any moves; prolongation [W,V]: from the coarse mesh's V vertices to the W of the full one;
    contours: the coarse mesh's own would show cut corners.
    """

    mesh: Mesh
    before: Mesh
    prolongation: sparse.csr_matrix
    contours: Sequence[SilhouetteContour]

    def moved_with(self, after: Mesh) -> Mesh:
        """Return the full mesh once the coarse one has moved to `after`."""
        return self.mesh.moved(self.mesh.vertices + self.prolongation @ (after.vertices - self.before.vertices))

    def gaps(self, after: Mesh) -> tuple[np.ndarray, np.ndarray]:
        """Return `contour_gaps` at the coarse mesh's vertices once it has moved to `after`."""
        gaps, touched = contour_gaps(self.moved_with(after), self.contours)
        sums, counts = self.prolongation.T @ (gaps * touched), self.prolongation.T @ touched
        return sums / np.maximum(counts, 1e-9), counts


def _bend(
    mesh: Mesh, fine: _FineMesh, target: TargetNormals, reach: float, pixel: float, options: ShadingOptions
) -> Mesh:
    """Return the coarse mesh moved to fit the light's normals, the contours and its own place.

    reach: in the scene's unit; larger shape stays.
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


def _fair(mesh: Mesh, angle: float) -> Mesh:
    return bilateral_normal_filter(mesh, angle) if angle else mesh


def _mean_around(values: np.ndarray, weights: np.ndarray, laplacian: sparse.csr_matrix, reach: float) -> np.ndarray:
    """Average values [V] by their weights [V] over about `reach` edges around."""
    sums = diffuse(np.stack([values * weights, weights], axis=1), laplacian, reach)
    means: np.ndarray = sums[:, 0] / np.maximum(sums[:, 1], 1e-9)
    return means
