"""Ambient occlusion and one-bounce interreflection of a surface.

A matte point shines alike to all sides. So what a photograph shows of the surface around a point, weighed by how much
of the point's sky it fills and by its tilt, is what arrives from there: the first of the bounces (radiosity). Both
change slowly along a surface, so a coarse copy of it is enough.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from mgsr.geometry.mesh import Mesh
from mgsr.geometry.triangles import tangents
from mgsr.parallel import map_ahead
from mgsr.shading.observations import LinearPhotograph, read_image, seen_frontal

RAYS = 64  # from a point into its sky
GRAZING = 0.05  # cosine of the tilt under which a photograph tells too little of how bright a point is
TURN = np.pi * (3 - np.sqrt(5))  # from ray to ray: the golden angle spreads them evenly


@dataclass(frozen=True)
class AmbientOcclusion:
    """Ambient occlusion and interreflection at the vertices of a coarse copy of a surface, both weighed by the cosine.

    sky_visibility [V]: the share of its sky that a vertex sees; interreflection [V,N]: the brightness that arrives
    there from the surface itself, in N photographs.
    """

    mesh: Mesh
    sky_visibility: np.ndarray
    interreflection: np.ndarray

    def at(self, points: np.ndarray, photographs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the open share of the sky [P], and the interreflected light [P,K], at points [P,3] beside
        the surface.

        photographs [P,K]: the photographs, by index, of which the interreflected light is asked for.
        """
        face, shares = self.mesh.caster.nearest(points)
        corners = self.mesh.faces[face]
        interreflection = sum(
            self.interreflection[corners[:, i, None], photographs] * shares[:, i, None] for i in range(3)
        )
        return (self.sky_visibility[corners] * shares).sum(axis=1), np.asarray(interreflection)


def estimate_occlusion(
    mesh: Mesh, photographs: Sequence[LinearPhotograph], gap: float, threads: int | None = None
) -> AmbientOcclusion:
    """Estimate ambient occlusion and one-bounce interreflection for every vertex of a mesh.

    gap: how far a vertex may lie behind its faces.
    """
    columns = map_ahead(lambda each: _shown(mesh, each, gap), photographs, threads)
    around = _around(mesh, gap)
    hidden = np.asarray(around.sum(axis=1)).ravel()
    return AmbientOcclusion(mesh, 1 - hidden, around @ np.stack(list(columns), axis=1))


def _shown(mesh: Mesh, photograph: LinearPhotograph, gap: float) -> np.ndarray:
    """Return each vertex's brightness in a photograph, [V]; 0 where it is not seen."""
    vertices, normals = mesh.vertices, mesh.double_normals
    offsets = photograph.camera.center - vertices
    cosines = (offsets * normals).sum(axis=1) / np.linalg.norm(offsets, axis=1)
    seen = seen_frontal(
        mesh.caster, photograph.camera, vertices, normals, cosines > GRAZING, gap, photograph.valid_mask
    )
    pixels, _ = photograph.camera.project(vertices[seen])
    brightness = np.zeros(len(vertices), np.float32)
    brightness[seen] = read_image(photograph.brightness, pixels)
    return brightness


def _around(mesh: Mesh, gap: float) -> sparse.csr_matrix:
    """Return the share of each vertex's sky (row) that each other vertex fills, [V,V].

    RAYS rays are cast from each vertex, distributed by the cosine, on a spiral that is turned from vertex to vertex.
    """
    vertices, faces, normals = mesh.vertices, mesh.faces, mesh.double_normals
    first, second = tangents(normals)
    outwards = mesh.face_crosses
    turned = 2 * np.pi * np.random.default_rng(0).random(len(vertices))
    places, shares = [], []
    for ray in range(RAYS):
        square, angle = (ray + 0.5) / RAYS, ray * TURN + turned
        level = np.sqrt(square) * (np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * second)
        directions = level + np.sqrt(1 - square) * normals
        hits = mesh.caster.cast_rays(vertices + gap * normals, directions)
        met = np.flatnonzero(hits.mask)
        met = met[(outwards[hits.face[met]] * directions[met]).sum(axis=1) < 0]
        places.append(np.stack([np.repeat(met, 3), faces[hits.face[met]].ravel()]))
        shares.append(hits.barycentric[met].ravel() / RAYS)
    size = (len(vertices), len(vertices))
    return sparse.coo_matrix((np.concatenate(shares), np.concatenate(places, axis=1)), size).tocsr()
