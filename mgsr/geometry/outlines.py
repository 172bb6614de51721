"""The mesh registered to the photographs' outlines: where it ends in an image, it ends where the mask ends.

A splat fades out, so the outline of a rendered surface is only known to a good part of a pixel, and training leaves
it a little inside. A mask's alpha is the covered share of each pixel and tells its outline to about a twentieth.
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
    """The outline of a mask; its parts at the border of the image, or of what is known of it, where the object is cut
    off, are left out."""
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
    """The vertices [V,3] moved along their normals so that the mesh's outlines fall on the masks'.

    smoothing: over about how many pixels of the masks a correction spreads.
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
    """How far [V] the vertices should move along their normals [V,3] for the mesh's outlines to fall on the masks', and
    how many points of outlines [V] say so; 0 where none does."""
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
    """Where the mesh ends beside [Q] outline points: the face, the point's barycentric shares [Q,3] on it, the world
    direction out of the mask [Q,3] and the distance [Q] from there to the outline, positive outwards, in the scene's
    unit."""

    faces: np.ndarray
    shares: np.ndarray
    outwards: np.ndarray
    gaps: np.ndarray


def _rims(caster: RayCaster, outline: Outline) -> _Rims:
    """The last point of the mesh on the way out across the outline, where it lies within reach."""
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
    """Pixels [Q,S,2] at these steps [S] or [Q,S] out of the mask from its outline's points, or `which` of them."""
    return outline.points[which, None] + steps[..., None] * outline.outwards[which, None]
