"""Ambient occlusion and one-bounce interreflection of a surface.

A matte point is equally bright from all directions, so photographs show the light that it sends to other points. The
first bounce (radiosity) at a point is the mean of the brightness of the surface around it. Each part of the surface
weighs by the cosine and by the share of the point's sky that it fills. Occlusion and interreflection vary slowly along
a surface, so a coarse mesh is enough.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from mgsr.config.expert import OcclusionOptions
from mgsr.data.photograph import Photograph
from mgsr.geometry.mesh import Mesh
from mgsr.geometry.triangles import tangents
from mgsr.geometry.vectors import dots, lengths
from mgsr.parallel import map_ahead
from mgsr.shading.observations import sample_image, seen_frontal

TURN = np.pi * (3 - np.sqrt(5))  # radians from ray to ray: the golden angle spreads the rays evenly


@dataclass(frozen=True)
class AmbientOcclusion:
    """Cosine-weighted ambient occlusion and interreflection at the vertices of a coarse mesh of the surface.

    sky_visibility [V]: the visible share of each vertex's sky, 0..1.
    interreflection [V,N]: the linear light that the surface itself sends to each vertex, in N photographs.
    """

    mesh: Mesh
    sky_visibility: np.ndarray
    interreflection: np.ndarray

    def at(self, points: np.ndarray, photographs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the sky visibility [P] and the interreflected light [P,K] at points [P,3] near the surface.

        photographs [P,K]: the indices of the photographs for the interreflected light.
        """
        face, shares = self.mesh.caster.nearest(points)
        corners = self.mesh.faces[face]
        interreflection = sum(
            self.interreflection[corners[:, i, None], photographs] * shares[:, i, None] for i in range(3)
        )
        return (self.sky_visibility[corners] * shares).sum(axis=1), np.asarray(interreflection)


def estimate_occlusion(
    mesh: Mesh,
    photographs: Sequence[Photograph],
    gap: float,
    threads: int | None = None,
    options: OcclusionOptions = OcclusionOptions(),
) -> AmbientOcclusion:
    """Estimate ambient occlusion and one-bounce interreflection for every vertex of a mesh.

    gap: the largest depth of a vertex behind the faces around it, in the scene's unit.
    """
    columns = map_ahead(lambda each: _shown(mesh, each, gap, options.min_cosine), photographs, threads)
    seen = trace_hemispheres(mesh, gap, options.rays)
    return AmbientOcclusion(mesh, seen.visibility, seen.surface @ np.stack(list(columns), axis=1))


def _shown(mesh: Mesh, photograph: Photograph, gap: float, min_cosine: float) -> np.ndarray:
    """Return each vertex's brightness [V] in a photograph, in linear light; 0 where it is not visible."""
    vertices, normals = mesh.vertices, mesh.double_normals
    offsets = photograph.camera.center - vertices
    cosines = dots(offsets, normals) / lengths(offsets)
    seen = seen_frontal(
        mesh.caster, photograph.camera, vertices, normals, cosines > min_cosine, gap, photograph.interior
    )
    pixels, _ = photograph.camera.project(vertices[seen])
    brightness = np.zeros(len(vertices), np.float32)
    brightness[seen] = sample_image(photograph.brightness, pixels)
    return brightness


@dataclass(frozen=True)
class Hemispheres:
    """The hemispheres above the vertices of a mesh, weighted by the cosine to their normals.

    surface [V,V]: the share of each vertex's sky (row) that every other vertex (column) fills.
    sky [V,9]: the mean of each real spherical harmonic up to degree 2 over the whole sky; hidden directions count as
    0. The irradiance by light with coefficients c [9] is `sky @ c`.
    """

    surface: sparse.csr_matrix
    sky: np.ndarray

    @property
    def visibility(self) -> np.ndarray:
        """Return the visible share [V] of each vertex's sky, 0..1."""
        return np.asarray(1 - np.asarray(self.surface.sum(axis=1)).ravel())


def trace_hemispheres(mesh: Mesh, gap: float, rays: int = OcclusionOptions().rays) -> Hemispheres:
    """Trace the hemisphere above each vertex of a mesh.

    gap: the largest depth of a vertex behind the faces around it, in the mesh's unit. Each vertex casts `rays` rays
    with a cosine distribution, on a spiral that is rotated from vertex to vertex. Faces seen from behind hide nothing.
    """
    vertices, faces, normals = mesh.vertices, mesh.faces, mesh.double_normals
    first, second = tangents(normals)
    outwards = mesh.face_crosses
    turned = 2 * np.pi * np.random.default_rng(0).random(len(vertices))
    places, shares, sky = [], [], np.zeros((len(vertices), 9))
    for ray in range(rays):
        square, angle = (ray + 0.5) / rays, ray * TURN + turned
        level = np.sqrt(square) * (np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * second)
        directions = level + np.sqrt(1 - square) * normals
        hits = mesh.caster.cast_rays(vertices + gap * normals, directions)
        met = np.flatnonzero(hits.mask)
        met = met[(outwards[hits.face[met]] * directions[met]).sum(axis=1) < 0]
        places.append(np.stack([np.repeat(met, 3), faces[hits.face[met]].ravel()]))
        shares.append(hits.barycentric[met].ravel() / rays)
        seen = real_harmonics(directions) / rays
        seen[met] = 0
        sky += seen
    size = (len(vertices), len(vertices))
    surface = sparse.coo_matrix((np.concatenate(shares), np.concatenate(places, axis=1)), size).tocsr()
    return Hemispheres(surface, sky)


def real_harmonics(directions: np.ndarray) -> np.ndarray:
    """Return the real spherical harmonics up to degree 2 [P,9] in unit directions [P,3], divided by that of degree 0.

    Source: Ramamoorthi and Hanrahan, 2001.
    """
    x, y, z = directions.T
    one, two = 3**0.5, 15**0.5
    values = [1 + 0 * x, one * x, one * y, one * z, two * x * y, two * y * z, two * z * x]
    return np.stack([*values, two / 2 * (x * x - y * y), 5**0.5 / 2 * (3 * z * z - 1)], axis=1)
