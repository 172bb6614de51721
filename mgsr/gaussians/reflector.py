"""The finished mesh as the reflecting surface: its normals in each pixel, and the pixels in which it reflects itself.

A normal error of one degree turns the reflection by two. The mesh's normals are several times more accurate than
blended splat normals. A reflected ray that meets the mesh again is reflected once more.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from scipy.ndimage import distance_transform_edt
from torch import Tensor

from mgsr.data.camera import Camera
from mgsr.geometry.mesh import Mesh
from mgsr.geometry.raycast import PixelHits
from mgsr.geometry.triangles import reflect, unit_vectors

KEPT = 256 * 2**20  # size of the cache of camera views, bytes
GAP = 0.005  # of the mesh's longest side, at most
BESIDE = 4.0  # pixels; splats reach so far beyond the mesh, or less


@dataclass(frozen=True)
class ReflectorView:
    """The reflecting surface as a camera sees it.

    normals [H,W,3] float16: unit, scene's frame. They are the surface's normals. Where the reflected ray meets the
    surface again, they instead reflect the line of sight into the direction of the second bounce. Beside the surface
    they are copied from its nearest pixel, and zero where there is none. near [N], bounced [P] int64: flat indices (row
    x W + column) of the pixels at most BESIDE off the surface, and of those with a second bounce.
    """

    normals: Tensor
    near: Tensor
    bounced: Tensor

    @property
    def size(self) -> int:
        """Return the number of bytes that the tensors take."""
        return self.normals.nbytes + self.near.nbytes + self.bounced.nbytes


class Reflector:
    """A mesh that reflects, in the scene's frame and with outward faces."""

    def __init__(self, mesh: Mesh) -> None:
        self.mesh = mesh
        # Offset of reflected rays from the surface: between their corners, facets deviate from the interpolated
        # normals.
        self._gap = min(mesh.edge_length, GAP * float(np.ptp(mesh.vertices, axis=0).max()))
        self._kept: dict[tuple[bytes, bytes, int, int, torch.device], ReflectorView] = {}
        self._size = 0

    def seen_by(self, camera: Camera, device: torch.device) -> ReflectorView:
        """Return the surface as a camera sees it, on a device.

        Results are cached, up to KEPT bytes in total.
        """
        key = (camera.K.tobytes(), camera.cam_from_world.tobytes(), camera.width, camera.height, device)
        seen = self._kept.get(key)
        if seen is None:
            seen = ReflectorView(*(torch.from_numpy(array).to(device) for array in self._trace(camera)))
            if self._size + seen.size <= KEPT:
                self._kept[key] = seen
                self._size += seen.size
        return seen

    def _trace(self, camera: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return `ReflectorView`'s arrays: normals [H,W,3], near [N] and bounced [P]."""
        middles = np.stack(np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5), axis=-1)
        hits = self.mesh.caster.cast_pixels(camera, middles)
        pixels = np.flatnonzero(hits.mask)
        normals = np.zeros((camera.height * camera.width, 3))
        if not len(pixels):
            return normals.reshape(camera.height, camera.width, 3).astype(np.float16), pixels, pixels
        points, own = self._at(hits)
        eye = unit_vectors(camera.center - points)
        bounced, turned = self._second(points, own, eye)
        normals[pixels] = own
        normals[pixels[bounced]] = turned
        image = normals.reshape(camera.height, camera.width, 3)
        away, nearest = distance_transform_edt(~hits.mask, return_indices=True)
        return image[tuple(nearest)].astype(np.float16), np.flatnonzero(away <= BESIDE), pixels[bounced]

    def _second(self, points: np.ndarray, normals: np.ndarray, eye: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Find the points whose reflected ray meets the surface again, and follow it one bounce further.

        points, normals, eye [P,3]: places, unit normals and unit directions to the eye. Returns the indices [Q] of
        these points, and the unit vectors [Q,3] halfway between the eye and the direction of the second bounce.
        """
        first = reflect(eye, normals)
        hits = self.mesh.caster.cast_rays(points + self._gap * normals, first)
        bounced = np.flatnonzero(hits.mask)
        _, there = self._at(hits)
        return bounced, unit_vectors(eye[bounced] + reflect(-first[bounced], there))

    def _at(self, hits: PixelHits) -> tuple[np.ndarray, np.ndarray]:
        """Return the places [P,3] and unit normals [P,3] where rays meet the surface."""
        corners, shares = self.mesh.faces[hits.face[hits.mask]], hits.barycentric[hits.mask].astype(np.float64)
        values = self.mesh.vertices, self.mesh.double_normals
        place, normal = (np.einsum("pk,pki->pi", shares, each[corners]) for each in values)
        return place, unit_vectors(normal)
