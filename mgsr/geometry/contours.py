"""Registration of a mesh to the masks' silhouette contours.

Splats fade out, so the contour of a rendered surface is uncertain by a large fraction of a pixel, and training leaves
it slightly inside the mask. A mask's alpha is the covered share of each pixel and gives its contour to about 0.05
pixels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from mgsr.config.expert import ContourOptions, ContourSearchOptions
from mgsr.data.camera import Camera, pixel_size
from mgsr.data.silhouettes import Silhouette
from mgsr.data.valid_mask import valid_inside
from mgsr.geometry.decimate import coarser
from mgsr.geometry.displace import smooth_displacements
from mgsr.geometry.mesh import Mesh
from mgsr.geometry.raycast import RayCaster
from mgsr.geometry.vectors import dots
from mgsr.parallel import map_ahead

BLUR, FARTHEST = 0.7, 4.0  # pixels; of the distance to a contour before its gradient, and its largest magnitude there


@dataclass(frozen=True)
class SilhouetteContour:
    """A mask's contour: points [P,2] in pixels, and unit directions outwards [P,2] that point out of the mask."""

    camera: Camera
    points: np.ndarray
    outwards: np.ndarray


def find_contour(silhouette: Silhouette) -> SilhouetteContour:
    """Find the silhouette contour of a mask to a fraction of a pixel.

    The contour leaves out parts near the border of the image or of its valid pixels, where the object is cut off.
    """
    distance = silhouette.distance
    slope_y, slope_x = np.gradient(ndimage.gaussian_filter(np.clip(distance, -FARTHEST, FARTHEST), BLUR))
    near = np.abs(distance) < 0.5
    near[[0, 1, -2, -1]] = False
    near[:, [0, 1, -2, -1]] = False
    if silhouette.valid_mask is not None:
        near &= valid_inside(silhouette.valid_mask, 2)
    rows, columns = np.nonzero(near)
    slopes = np.stack([slope_x[rows, columns], slope_y[rows, columns]], axis=1)
    steep = np.linalg.norm(slopes, axis=1)
    clear = steep > 0.5  # elsewhere two contours meet, at a thin part or a corner
    inwards = slopes[clear] / steep[clear, None]
    centers = np.stack([columns[clear], rows[clear]], axis=1) + 0.5
    return SilhouetteContour(silhouette.camera, centers - inwards * distance[rows, columns][clear, None], -inwards)


def fit_contours(
    mesh: Mesh, contours: Sequence[SilhouetteContour], smoothing: float, options: ContourOptions = ContourOptions()
) -> Mesh:
    """Move a mesh along its normals so that its silhouette contours coincide with the masks'.

    smoothing: the distance, in mask pixels, over which a correction spreads.
    """
    pixel = pixel_size([contour.camera for contour in contours], mesh.vertices.mean(axis=0))
    coarse = coarser(mesh, options.coarse_edge * pixel, options.max_faces)
    prolongation, stay = coarse.prolongation(mesh.vertices), options.prior_weight
    reach = smoothing * pixel / coarse.edge_length * (len(mesh.vertices) / len(coarse.vertices)) ** 0.25
    for _ in range(options.rounds):
        target, touched = contour_gaps(mesh, contours, options.search)
        held = np.minimum(touched, 1)
        moves = prolongation @ smooth_displacements(
            coarse.laplacian, target * held / (held + stay), held + stay, reach, prolongation
        )
        limit = options.search.search * pixel
        mesh = mesh.moved(mesh.vertices + np.clip(moves, -limit, limit)[:, None] * mesh.normals)
    return mesh


def contour_gaps(
    mesh: Mesh, contours: Sequence[SilhouetteContour], options: ContourSearchOptions = ContourSearchOptions()
) -> tuple[np.ndarray, np.ndarray]:
    """Return the displacements [V] along a mesh's normals that bring its silhouette contours onto the masks'.

    Displacements are in the scene's unit. Also returns the number [V] of contour points that touch each vertex, as sums
    of barycentric coordinates. Both are 0 where no contour touches.
    """
    faces, normals, count, caster = mesh.faces, mesh.normals, len(mesh.vertices), mesh.caster
    sums, touched = np.zeros(count), np.zeros(count)
    for found in map_ahead(lambda contour: _mesh_contour(caster, contour, options), contours, None):
        corners = faces[found.faces]
        facing = dots((normals[corners] * found.shares[..., None]).sum(1), found.outwards)
        good = facing > options.facing
        shares, corners = found.shares[good], corners[good]
        target = (found.gaps * facing)[good, None] * shares
        sums += np.bincount(corners.ravel(), target.ravel(), count)
        touched += np.bincount(corners.ravel(), shares.ravel(), count)
    return sums / np.maximum(touched, 1e-9), touched


@dataclass(frozen=True)
class _MeshContour:
    """Q points of the mesh's silhouette contour, each beside a point of a mask's contour.

    faces [Q]: the face of each point. shares [Q,3]: its barycentric coordinates. outwards [Q,3]: the unit direction out
    of the mask, in the world frame. gaps [Q]: the distance to the mask's contour, positive outwards, in the scene's
    unit.
    """

    faces: np.ndarray
    shares: np.ndarray
    outwards: np.ndarray
    gaps: np.ndarray


def _mesh_contour(caster: RayCaster, contour: SilhouetteContour, options: ContourSearchOptions) -> _MeshContour:
    """Find the mesh's outermost point across each contour point, if it lies within the search distance."""
    search, step, finer = options.search, options.step, options.finer
    camera, steps = contour.camera, np.arange(-search, search + step / 2, step)
    mask = caster.cast_pixels(camera, _beside(contour, steps)).mask
    last = len(steps) - 1 - mask[:, ::-1].argmax(axis=1)
    found = np.flatnonzero(mask.any(axis=1) & (last < len(steps) - 1))
    steps = steps[last[found], None] + np.arange(finer) * (step / finer)
    hits = caster.cast_pixels(camera, _beside(contour, steps, found))
    last = finer - 1 - hits.mask[:, ::-1].argmax(axis=1)
    row = np.arange(len(found))
    sizes = hits.depth[row, last] / np.sqrt(camera.K[0, 0] * camera.K[1, 1])
    return _MeshContour(
        hits.face[row, last].astype(np.int64),
        hits.barycentric[row, last],
        contour.outwards[found] @ camera.cam_from_world[:2, :3],
        -(steps[row, last] + step / finer / 2) * sizes,
    )


def _beside(contour: SilhouetteContour, steps: np.ndarray, which: np.ndarray | slice = slice(None)) -> np.ndarray:
    """Return the pixel coordinates [Q,S,2] at distances `steps` [S] or [Q,S] outwards of the contour's points.

    steps: in pixels. which: the indices [Q] of the contour points to use; all by default.
    """
    samples: np.ndarray = contour.points[which, None] + steps[..., None] * contour.outwards[which, None]
    return samples
