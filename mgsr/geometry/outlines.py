"""Registration of a mesh to the masks' silhouette contours.

A splat fades out, so the contour of a rendered surface is only known to a good part of a pixel, and training leaves it
a little inside. A mask's alpha is the covered share of each pixel and tells its contour to about a twentieth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from mgsr.data.camera import Camera, pixel_size
from mgsr.data.known import known_inside
from mgsr.data.silhouettes import Silhouette
from mgsr.geometry.decimate import coarser
from mgsr.geometry.displace import edge_length, smooth_displacements, umbrella
from mgsr.geometry.raycast import RayCaster, interpolation
from mgsr.geometry.triangles import vertex_normals
from mgsr.parallel import map_ahead

SEARCH = 3.0  # pixels to both sides of a mask's outline in which the mesh's is looked for
STEP = 0.25  # pixels between two rays that look for the mesh's outline
FINER = 8  # parts of a step, to which it is then found: coarser ones pull surfaces inwards by 0.04 pixels
FACING = 0.5  # least cosine between a vertex normal and the outline's direction
COARSE = 1.0  # pixels; edges of the mesh on which the correction is found, as it is smooth
STAY = 0.02  # a vertex that no outline touches follows its surroundings, but not for ever


@dataclass(frozen=True)
class Outline:
    """A mask's outline: points [P,2] in pixels, and at each the unit direction [P,2] that leads out of the mask."""

    camera: Camera
    points: np.ndarray
    outwards: np.ndarray


def find_outline(silhouette: Silhouette) -> Outline:
    """Find the silhouette contour of a mask to a fraction of a pixel.

    Parts at the border of the image, or of its known pixels, where the object is cut off, are left out.
    """
    distance = silhouette.distance
    slope_y, slope_x = np.gradient(ndimage.gaussian_filter(np.clip(distance, -4, 4), 0.7))
    near = np.abs(distance) < 0.5
    near[[0, 1, -2, -1]] = False
    near[:, [0, 1, -2, -1]] = False
    if silhouette.known is not None:
        near &= known_inside(silhouette.known, 2)
    rows, columns = np.nonzero(near)
    slopes = np.stack([slope_x[rows, columns], slope_y[rows, columns]], axis=1)
    steep = np.linalg.norm(slopes, axis=1)
    clear = steep > 0.5  # elsewhere two outlines meet: a thin part, a corner
    inwards = slopes[clear] / steep[clear, None]
    centers = np.stack([columns[clear], rows[clear]], axis=1) + 0.5
    return Outline(silhouette.camera, centers - inwards * distance[rows, columns][clear, None], -inwards)


def fit_outlines(
    vertices: np.ndarray, faces: np.ndarray, outlines: Sequence[Outline], smoothing: float, rounds: int = 2
) -> np.ndarray:
    """Return the vertices [V,3] moved along their normals so that the mesh's contours fall on the masks'.

    smoothing: the number of mask pixels over which a correction spreads.
    """
    pixel = pixel_size([outline.camera for outline in outlines], vertices.mean(axis=0))
    coarse, triangles = coarser(vertices, faces, COARSE * pixel)
    carry, laplacian = interpolation(coarse, triangles, vertices), umbrella(triangles, len(coarse))
    reach = smoothing * pixel / edge_length(coarse, triangles) * (len(vertices) / len(coarse)) ** 0.25
    for _ in range(rounds):
        normals = vertex_normals(vertices, faces)
        wanted, touched = outline_gaps(vertices, faces, normals, outlines)
        held = np.minimum(touched, 1)
        moves = carry @ smooth_displacements(laplacian, wanted * held / (held + STAY), held + STAY, reach, carry)
        limit = SEARCH * pixel
        vertices = vertices + np.clip(moves, -limit, limit)[:, None] * normals
    return vertices


def outline_gaps(
    vertices: np.ndarray, faces: np.ndarray, normals: np.ndarray, outlines: Sequence[Outline]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the displacements [V] along the normals that bring the mesh's contours onto the masks'.

    vertices, normals [V,3]; faces [F,3]. Also returns the number [V] of contour points that tell each vertex's
    displacement, counted in barycentric shares. Both are 0 where none does. Displacements are in the scene's unit.
    """
    caster = RayCaster(vertices, faces)
    sums, touched = np.zeros(len(vertices)), np.zeros(len(vertices))
    for rims in map_ahead(lambda outline: _rims(caster, outline), outlines, None):
        corners = faces[rims.faces]
        facing = ((normals[corners] * rims.shares[..., None]).sum(1) * rims.outwards).sum(1)
        good = facing > FACING
        shares, corners = rims.shares[good], corners[good]
        wanted = (rims.gaps * facing)[good, None] * shares
        sums += np.bincount(corners.ravel(), wanted.ravel(), len(vertices))
        touched += np.bincount(corners.ravel(), shares.ravel(), len(vertices))
    return sums / np.maximum(touched, 1e-9), touched


@dataclass(frozen=True)
class _Rims:
    """The mesh's silhouette beside Q points of a mask's contour.

    faces [Q]: the face that ends there; shares [Q,3]: the barycentric coordinates on it; outwards [Q,3]: the world
    direction out of the mask; gaps [Q]: the distance from there to the contour, positive outwards, in the scene's unit.
    """

    faces: np.ndarray
    shares: np.ndarray
    outwards: np.ndarray
    gaps: np.ndarray


def _rims(caster: RayCaster, outline: Outline) -> _Rims:
    """Find the mesh's last point on the way out across each contour point, where it lies within SEARCH pixels."""
    camera, steps = outline.camera, np.arange(-SEARCH, SEARCH + STEP / 2, STEP)
    mask = caster.cast_pixels(camera, _beside(outline, steps)).mask
    last = len(steps) - 1 - mask[:, ::-1].argmax(axis=1)
    found = np.flatnonzero(mask.any(axis=1) & (last < len(steps) - 1))
    steps = steps[last[found], None] + np.arange(FINER) * (STEP / FINER)
    hits = caster.cast_pixels(camera, _beside(outline, steps, found))
    last = FINER - 1 - hits.mask[:, ::-1].argmax(axis=1)
    row = np.arange(len(found))
    sizes = hits.depth[row, last] / np.sqrt(camera.K[0, 0] * camera.K[1, 1])
    return _Rims(
        hits.face[row, last].astype(np.int64),
        hits.barycentric[row, last],
        outline.outwards[found] @ camera.cam_from_world[:2, :3],
        -(steps[row, last] + STEP / FINER / 2) * sizes,
    )


def _beside(outline: Outline, steps: np.ndarray, which: np.ndarray | slice = slice(None)) -> np.ndarray:
    """Return pixel coordinates [Q,S,2], `steps` [S] or [Q,S] pixels outwards of the contour's points.

    which: the contour points to use, by index; all by default.
    """
    samples: np.ndarray = outline.points[which, None] + steps[..., None] * outline.outwards[which, None]
    return samples
