"""Shape from shading: a surface is bent to the normals that the photographs' shading tells.

Two light models are tried: a flash on the camera, and an environment that stands still and is mirrored. Where neither
explains the photographs, the surface stays. Normals know the small shape best and positions the large (Nehab and others
2005), and the masks' contours hold the surface where they touch it.
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
from mgsr.geometry.fairing import smooth_noise
from mgsr.geometry.outlines import Outline, outline_gaps
from mgsr.geometry.raycast import interpolation
from mgsr.geometry.triangles import vertex_normals
from mgsr.shading.explained import Explained
from mgsr.shading.flash import flash_ratio
from mgsr.shading.kinds import ByFlash, ByMirroring, Shading, Shot, mirrored_surroundings
from mgsr.shading.readings import linear_photographs

TOUCHED = 10.0  # how much a vertex that an outline touches holds its place
STAY = 0.05  # how much any other does
OUTLINE_SMOOTHING = 1.5  # pixels over which what the outlines say is smoothed


class Light(StrEnum):
    """The light of a capture, as far as the photographs tell.

    flash: on the camera; surroundings: standing still, mirrored by the surface; unknown: neither explains enough.
    """

    FLASH = "flash"
    SURROUNDINGS = "surroundings"
    UNKNOWN = "unknown"


MIRRORS = 0.85  # of what differs between the photographs; mirrored surroundings that leave more unexplained, on a
# surface that is known roughly, tell nothing
RATIO_EDGE = 2.0  # pixels; edges of the mesh on which the kinds of light are compared


@dataclass(frozen=True)
class Pass:
    """Rounds of reading the photographs and bending the surface, with edges of about `edge` pixels.

    Shape larger than `reach` pixels stays as it is, but for what the contours say. fairing: degrees; noise up to this
    is smoothed before and after the rounds (`smooth_noise`); 0: none.
    """

    edge: float
    rounds: int
    reach: float
    fairing: float = 0.0


@dataclass(frozen=True)
class Refined:
    """A surface refined by shading.

    vertices [V,3]: moved where the light is known; shading: the light model, None for an unknown light.
    """

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
    """Move the vertices [V,3] of a mesh so that its shading explains the photographs, if a light model does.

    outlines: the masks' contours, which hold the surface; none without masks.
    max_ratio: the largest share that the light may leave unexplained.
    passes: how each light bends the surface; a light without any is only identified.
    go_on: asked before every round; once it says no, no more rounds follow.
    progress: told after each round of the share of the rounds that are done.
    """
    pixel = pixel_size([view.camera for view in views], vertices.mean(axis=0))
    shot = Shot(linear_photographs(views), pixel, threads)
    light, shading = _find_light(shot, *coarser(vertices, faces, RATIO_EDGE * pixel), max_ratio)
    if shading is None:
        return Refined(vertices, light)
    chosen = passes.get(light, ())
    rounds = sum(each.rounds for each in chosen)
    done = 0
    for each in chosen:
        vertices = _fair(vertices, faces, each.fairing)
        before, triangles = coarser(vertices, faces, each.edge * pixel)
        carry = interpolation(before, triangles, vertices)
        whole = _Whole(vertices, faces, before, carry, outlines)
        work = _Work(triangles, edges(triangles), umbrella(triangles, len(before)), whole, pixel)
        after = before
        for _ in range(each.rounds):
            if not go_on():
                break
            after = work.bend(after, *shading.explain(after, triangles, work.laplacian), each.reach)
            done += 1
            progress(done / rounds)
        vertices = _fair(vertices + carry @ (after - before), faces, each.fairing)
    return Refined(vertices, light, shading)


def _find_light(shot: Shot, vertices: np.ndarray, faces: np.ndarray, max_ratio: float) -> tuple[Light, Shading | None]:
    """Return the light that leaves least unexplained on the mesh as it is, and its model.

    Where that is more than max_ratio, the light is unknown and the model None.
    """
    readings, normals = shot.read(vertices, faces)
    by_flash, by_mirroring = flash_ratio(readings, normals), mirrored_surroundings(readings, normals).ratio
    if not min(by_flash, by_mirroring) <= max_ratio:
        return Light.UNKNOWN, None
    if by_flash <= by_mirroring:
        return Light.FLASH, ByFlash(shot, vertices, faces, readings, normals)
    return Light.SURROUNDINGS, ByMirroring(shot)


@dataclass(frozen=True)
class _Whole:
    """The full mesh that a coarser one's moves are carried over to, and the contours that it is held against.

    vertices [W,3], faces: before any moves; before [V,3]: the coarse mesh's vertices; carry [W,V]: the interpolation of
    their moves; outlines: the contours. Those of the coarse mesh would show cut corners.
    """

    vertices: np.ndarray
    faces: np.ndarray
    before: np.ndarray
    carry: sparse.csr_matrix
    outlines: Sequence[Outline]

    def gaps(self, after: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return `outline_gaps` at the coarse mesh's vertices once they are at `after` [V,3]."""
        vertices = self.vertices + self.carry @ (after - self.before)
        gaps, touched = outline_gaps(vertices, self.faces, vertex_normals(vertices, self.faces), self.outlines)
        sums, counts = self.carry.T @ (gaps * touched), self.carry.T @ touched
        return sums / np.maximum(counts, 1e-9), counts


@dataclass(frozen=True)
class _Work:
    """The coarse mesh that is bent, but for its vertices, and the full one."""

    faces: np.ndarray
    edges: np.ndarray
    laplacian: sparse.csr_matrix
    whole: _Whole
    pixel: float

    def bend(self, vertices: np.ndarray, normals: np.ndarray, explained: Explained, reach: float) -> np.ndarray:
        """Return the vertices [V,3] moved to fit the light's normals, the contours and their own places.

        normals [V,3]: the vertices' own; explained: the light's; reach: pixels; larger shape stays.
        """
        offsets, touched = self.whole.gaps(vertices)
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
        bent: np.ndarray = vertices + moves[:, None] * normals
        return bent


def _fair(vertices: np.ndarray, faces: np.ndarray, angle: float) -> np.ndarray:
    return smooth_noise(vertices, faces, angle) if angle else vertices


def _mean_around(values: np.ndarray, weights: np.ndarray, laplacian: sparse.csr_matrix, reach: float) -> np.ndarray:
    """Average values [V] by their weights [V] over about `reach` edges around."""
    sums = spread(np.stack([values * weights, weights], axis=1), laplacian, reach)
    means: np.ndarray = sums[:, 0] / np.maximum(sums[:, 1], 1e-9)
    return means
