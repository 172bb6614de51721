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
from mgsr.geometry.displace import (
    bend_to_normals,
    edge_length,
    edges,
    mean_normals,
    spread,
    umbrella,
)
from mgsr.geometry.outlines import Outline, outline_gaps
from mgsr.geometry.raycast import interpolation
from mgsr.geometry.triangles import vertex_normals
from mgsr.shading.explained import Explained
from mgsr.shading.flash import explain_by_flash, flash_ratio
from mgsr.shading.mirroring import explain_by_mirroring
from mgsr.shading.readings import Photograph, Readings, linear_photographs, read_photographs
from mgsr.shading.surroundings import fit_surroundings

TOUCHED = 10.0  # how much a vertex that an outline touches holds its place
STAY = 0.05  # how much any other does
OUTLINE_SMOOTHING = 1.5  # pixels over which what the outlines say is smoothed
POOL = 2.5  # pixels over which the readings of neighbours are put together
CONVEX = 0.12  # bend, in radians a pixel, from which an edge is left alone: it shows too little of each of its tilts


class Light(StrEnum):
    """flash: on the camera; surroundings: standing still, mirrored by the surface; unknown: neither explains enough."""

    FLASH = "flash"
    SURROUNDINGS = "surroundings"
    UNKNOWN = "unknown"


RATIO_EDGE = 2.0  # pixels; edges of the mesh on which the kinds of light are compared


@dataclass(frozen=True)
class Pass:
    """Rounds of reading the photographs and bending the surface, with edges of about `edge` pixels; what moved is
    smoothed over `smoothing` pixels."""

    edge: float
    rounds: int
    smoothing: float = 0.0


@dataclass(frozen=True)
class Refined:
    """vertices [V,3], moved where the light is known."""

    vertices: np.ndarray
    light: Light


def refine_by_shading(
    vertices: np.ndarray,
    faces: np.ndarray,
    views: Sequence[View],
    outlines: Sequence[Outline],
    max_ratio: float,
    reach: float,
    passes: Mapping[Light, Sequence[Pass]],
    threads: int | None = None,
    progress: Callable[[float], None] = lambda done: None,
    go_on: Callable[[], bool] = lambda: True,
) -> Refined:
    """The vertices [V,3] of a mesh moved so that shading explains the photographs, if it does.

    outlines: the masks', which hold the surface; none without masks.
    max_ratio: the largest share that the light may leave unexplained.
    reach: pixels; shape larger than this is left as it is, but for what the outlines say.
    passes: for each light, how the surface is bent. go_on: asked before every round; the surface stays as it is then
    once it says no.
    progress: told after each round of the share of the rounds that are done.
    """
    photographs = linear_photographs(views)
    pixel = pixel_size([view.camera for view in views], vertices.mean(axis=0))

    def work_on(edge: float) -> tuple[_Work, np.ndarray]:
        places, triangles = coarser(vertices, faces, edge * pixel)
        laplacian = umbrella(triangles, len(places))
        return _Work(triangles, edges(triangles), laplacian, photographs, outlines, pixel, threads), places

    ratios = _ratios(*work_on(RATIO_EDGE))
    light = min(ratios, key=lambda kind: ratios[kind])
    if not ratios[light] <= max_ratio:
        return Refined(vertices, Light.UNKNOWN)
    rounds = sum(each.rounds for each in passes[light])
    done = 0
    for each in passes[light]:
        work, before = work_on(each.edge)
        after = before
        for _ in range(each.rounds):
            if not go_on():
                break
            readings, normals = work.read(after)
            after = work.bend(after, normals, work.explain(light, after, readings, normals), reach)
            done += 1
            progress(done / rounds)
        moves = interpolation(before, work.faces, vertices) @ (after - before)
        vertices = vertices + _smoothed(moves, vertices, faces, each.smoothing * pixel)
    return Refined(vertices, light)


@dataclass(frozen=True)
class _Work:
    """The mesh that is worked on, but for its vertices, and what it is held against."""

    faces: np.ndarray
    edges: np.ndarray
    laplacian: sparse.csr_matrix
    photographs: Sequence[Photograph]
    outlines: Sequence[Outline]
    pixel: float
    threads: int | None

    def read(self, vertices: np.ndarray) -> tuple[Readings, np.ndarray]:
        """The photographs at the vertices, and the vertices' normals [V,3]."""
        normals = vertex_normals(vertices, self.faces).astype(np.float64)
        return read_photographs(vertices, self.faces, normals, self.photographs, self.pixel, self.threads), normals

    def explain(self, light: Light, vertices: np.ndarray, readings: Readings, normals: np.ndarray) -> Explained:
        """What the light says of the normals."""
        if light is Light.FLASH:
            return explain_by_flash(readings, normals)
        reach = POOL * self.pixel / edge_length(vertices, self.faces)
        still = _near_sharp_edges(vertices, self.laplacian, normals, self.pixel, reach)
        return explain_by_mirroring(readings, normals, self.laplacian, reach, still, self.threads)

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


def _ratios(work: _Work, vertices: np.ndarray) -> dict[Light, float]:
    """What each kind of light leaves unexplained on the mesh as it is."""
    readings, normals = work.read(vertices)
    return {
        Light.FLASH: flash_ratio(readings, normals),
        Light.SURROUNDINGS: fit_surroundings(readings, normals).ratio,
    }


def _near_sharp_edges(
    vertices: np.ndarray, laplacian: sparse.csr_matrix, normals: np.ndarray, pixel: float, reach: float
) -> np.ndarray:
    """1 at vertices beside a sharp convex edge, 0 far from all, [V]."""
    steps = laplacian @ vertices
    length = np.sqrt(np.maximum((laplacian @ (vertices**2)).sum(1) - 2 * (vertices * steps).sum(1), 1e-20))
    smooth = mean_normals(normals, laplacian, rounds=1)
    bend = -(steps * smooth).sum(1) * 4 / length**2 * pixel
    sharp = (spread(bend[:, None], laplacian, 0.7)[:, 0] > CONVEX).astype(float)
    return np.clip(4 * spread(sharp[:, None], laplacian, max(reach, 0.7))[:, 0], 0, 1)
