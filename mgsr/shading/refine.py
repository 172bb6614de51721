"""A surface bent to the normals that the photographs' shading tells.

Two kinds of light are tried: a flash on the camera, and surroundings that stand still and are mirrored. Where neither
explains the photographs, the surface stays. Normals know the small shape best and positions the large (Nehab and
others 2005), and the masks' outlines hold the surface where they touch it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from scipy import sparse

from mgsr.data.camera import pixel_size
from mgsr.data.scene import View
from mgsr.geometry.decimate import coarser
from mgsr.geometry.displace import bend_to_normals, edge_length, edges, spread, umbrella
from mgsr.geometry.outlines import Outline, outline_gaps
from mgsr.geometry.raycast import interpolation
from mgsr.shading.explained import Explained
from mgsr.shading.flash import flash_ratio
from mgsr.shading.kinds import ByFlash, ByMirroring, Shading, Shot
from mgsr.shading.readings import linear_photographs
from mgsr.shading.surroundings import fit_surroundings

TOUCHED = 10.0  # how much a vertex that an outline touches holds its place
STAY = 0.05  # how much any other does
OUTLINE_SMOOTHING = 1.5  # pixels over which what the outlines say is smoothed


class Light(StrEnum):
    """flash: on the camera; surroundings: standing still, mirrored by the surface; unknown: neither explains enough."""

    FLASH = "flash"
    SURROUNDINGS = "surroundings"
    UNKNOWN = "unknown"


RATIO_EDGE = 2.0  # pixels; edges of the mesh on which the kinds of light are compared


@dataclass(frozen=True)
class Pass:
    """Rounds of reading the photographs and bending the surface, with edges of about `edge` pixels. Shape larger than
    `reach` pixels is left as it is, but for what the outlines say; what moved is smoothed over `smoothing` pixels."""

    edge: float
    rounds: int
    reach: float
    smoothing: float = 0.0


@dataclass(frozen=True)
class Refined:
    """vertices [V,3], moved where the light is known; shading: what knows it, None for an unknown light."""

    vertices: np.ndarray
    light: Light
    shading: Shading | None = None


def refine_by_shading(
    vertices: np.ndarray,
    faces: np.ndarray,
    views: Sequence[View],
    outlines: Sequence[Outline],
    max_ratio: float,
    passes: Mapping[Light, Sequence[Pass]],
    threads: int | None = None,
    progress: Callable[[float], None] = lambda done: None,
    go_on: Callable[[], bool] = lambda: True,
) -> Refined:
    """The vertices [V,3] of a mesh moved so that shading explains the photographs, if it does.

    outlines: the masks', which hold the surface; none without masks.
    max_ratio: the largest share that the light may leave unexplained.
    passes: for each light, how the surface is bent. go_on: asked before every round; the surface stays as it is then
    once it says no.
    progress: told after each round of the share of the rounds that are done.
    """
    pixel = pixel_size([view.camera for view in views], vertices.mean(axis=0))
    shot = Shot(linear_photographs(views), pixel, threads)
    light, shading = _find_light(shot, *coarser(vertices, faces, RATIO_EDGE * pixel), max_ratio)
    if shading is None:
        return Refined(vertices, light)
    rounds = sum(each.rounds for each in passes[light])
    done = 0
    for each in passes[light]:
        before, triangles = coarser(vertices, faces, each.edge * pixel)
        work = _Work(triangles, edges(triangles), umbrella(triangles, len(before)), outlines, pixel)
        after = before
        for _ in range(each.rounds):
            if not go_on():
                break
            after = work.bend(after, *shading.explain(after, triangles, work.laplacian), each.reach)
            done += 1
            progress(done / rounds)
        moves = interpolation(before, triangles, vertices) @ (after - before)
        vertices = vertices + _smoothed(moves, vertices, faces, each.smoothing * pixel)
    return Refined(vertices, light, shading)


def _find_light(shot: Shot, vertices: np.ndarray, faces: np.ndarray, max_ratio: float) -> tuple[Light, Shading | None]:
    """The kind of light that leaves least unexplained on the mesh as it is, if that is little enough."""
    readings, normals = shot.read(vertices, faces)
    by_flash, by_mirroring = flash_ratio(readings, normals), fit_surroundings(readings, normals).ratio
    if not min(by_flash, by_mirroring) <= max_ratio:
        return Light.UNKNOWN, None
    if by_flash <= by_mirroring:
        return Light.FLASH, ByFlash(shot, vertices, faces, readings, normals)
    return Light.SURROUNDINGS, ByMirroring(shot)


@dataclass(frozen=True)
class _Work:
    """The mesh that is worked on, but for its vertices, and the outlines that it is held against."""

    faces: np.ndarray
    edges: np.ndarray
    laplacian: sparse.csr_matrix
    outlines: Sequence[Outline]
    pixel: float

    def bend(self, vertices: np.ndarray, normals: np.ndarray, explained: Explained, reach: float) -> np.ndarray:
        """The vertices moved to fit the normals, the outlines and their own places."""
        offsets, touched = outline_gaps(vertices, self.faces, normals, self.outlines)
        held = np.minimum(touched, 1)
        edge = edge_length(vertices, self.faces)
        offsets = _mean_around(offsets, held, self.laplacian, OUTLINE_SMOOTHING * self.pixel / edge)
        strength = STAY * (reach * self.pixel / (2 * np.pi * edge)) ** 2
        moves = bend_to_normals(
            vertices,
            self.edges,
            normals,
            explained.normals,
            explained.sure,
            strength,
            hold=STAY + TOUCHED * held,
            offsets=offsets * TOUCHED * held / (TOUCHED * held + STAY),
        )
        return vertices + moves[:, None] * normals


def _smoothed(moves: np.ndarray, vertices: np.ndarray, faces: np.ndarray, width: float) -> np.ndarray:
    """What moves the vertices, [V,3], averaged over about `width` around each."""
    if not width:
        return moves
    return spread(moves, umbrella(faces, len(vertices)), width / edge_length(vertices, faces))


def _mean_around(values: np.ndarray, weights: np.ndarray, laplacian: sparse.csr_matrix, reach: float) -> np.ndarray:
    """Values [V] averaged, by their weights [V], over about `reach` edges around."""
    sums = spread(np.stack([values * weights, weights], axis=1), laplacian, reach)
    return sums[:, 0] / np.maximum(sums[:, 1], 1e-9)
