"""The finished mesh as the reflecting surface: its normals in each pixel, and where it reflects itself.

A normal error of one degree turns the reflection by two. The mesh's normals are several times more accurate than
blended splat normals. A reflected ray that meets the mesh again is reflected once more.

Normals turn by several degrees within a pixel where a small image shows a strong curvature. What such a pixel reflects
is the mean over several samples.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable
from dataclasses import dataclass

import numpy as np
import torch
from scipy.ndimage import binary_dilation, distance_transform_edt
from torch import Tensor

from mgsr.data.camera import Camera, pixel_size
from mgsr.geometry.mesh import Mesh
from mgsr.geometry.raycast import PixelHits
from mgsr.geometry.triangles import reflect, unit_vectors
from mgsr.parallel import map_ahead

KEPT = 256 * 2**20  # size of the cache of camera views, bytes
GAP = 0.005  # of the mesh's longest side, at most
BESIDE = 4.0  # pixels; splats reach so far beyond the mesh, or less
# There are at least FINE samples along the mesh's longest side, but at most MOST_ROWS x MOST_ROWS in a pixel. Where the
# mesh is larger in an image, each pixel has one sample.
FINE = 512
MOST_ROWS = 4


@dataclass(frozen=True)
class ReflectorView:
    """The reflecting surface as a camera sees it, in N x N samples of each pixel.

    pixels [P], bounced_pixels [Q] int64: flat indices (row x W + column) of the pixels at most BESIDE off the surface,
    and of those with a second bounce.
    samples [P,N,N,3] float16: the surface's normals in the scene's frame, each as long as its share of the pixel's
    surface. They are zero where a sample misses the surface or has a second bounce. Beside the surface, a pixel has the
    samples of its nearest pixel.
    bounced [Q,N,N,3] float16: the samples whose reflected ray meets the surface again. These normals reflect the line
    of sight into the direction of the second bounce. The others are zero.
    """

    pixels: Tensor
    samples: Tensor
    bounced_pixels: Tensor
    bounced: Tensor

    @property
    def size(self) -> int:
        """Return the number of bytes that the tensors take."""
        return sum(each.nbytes for each in (self.pixels, self.samples, self.bounced_pixels, self.bounced))


class Reflector:
    """A mesh that reflects, in the scene's frame and with outward faces."""

    def __init__(self, mesh: Mesh) -> None:
        self.mesh = mesh
        low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
        self._middle, self._longest = (low + high) / 2, float((high - low).max())
        # Offset of reflected rays from the surface: between their corners, facets deviate from the interpolated
        # normals.
        self._gap = min(mesh.edge_length, GAP * self._longest)
        self._kept: dict[tuple[Hashable, ...], ReflectorView] = {}
        self._size = 0

    def seen_by(self, camera: Camera, device: torch.device) -> ReflectorView:
        """Return the surface as a camera sees it, on a device.

        Results are cached, up to KEPT bytes in total.
        """
        seen = self._kept.get(_key(camera, device))
        return self._keep(camera, device, self._trace(camera)) if seen is None else seen

    def prepare(self, cameras: Iterable[Camera], device: torch.device) -> None:
        """Fill the cache of `seen_by` with what cameras see, on all cores, until it is full."""
        cameras = list(cameras)
        for camera, arrays in zip(cameras, map_ahead(self._trace, cameras, None), strict=True):
            self._keep(camera, device, arrays)
            if _key(camera, device) not in self._kept:
                break

    def _keep(self, camera: Camera, device: torch.device, arrays: tuple[np.ndarray, ...]) -> ReflectorView:
        """Build a camera's view of its traced arrays on a device, and cache it if there is room."""
        seen = ReflectorView(*(torch.from_numpy(array).to(device) for array in arrays))
        if self._size + seen.size <= KEPT:
            self._kept[_key(camera, device)] = seen
            self._size += seen.size
        return seen

    def _trace(self, camera: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return the arrays of `ReflectorView`."""
        rows = self._rows(camera)
        pixels = self._covered(camera, rows)
        hits = self.mesh.caster.cast_pixels(camera, _sample_places(pixels, camera.width, rows))
        met = hits.mask.any(axis=(1, 2))
        normals, again = self._mirrored(hits, camera)
        found, nearest = _nearest(pixels[met], camera)
        normals, again = normals[met][nearest], again[met][nearest]
        twice = again.any(axis=(1, 2))
        once, more = np.where(again[..., None], 0, normals), np.where(again[twice][..., None], normals[twice], 0)
        return found, once.astype(np.float16), found[twice], more.astype(np.float16)

    def _rows(self, camera: Camera) -> int:
        """Return the number of rows of samples in a pixel."""
        wanted = FINE * pixel_size([camera], self._middle) / self._longest
        return int(np.clip(np.ceil(wanted), 1, MOST_ROWS))

    def _covered(self, camera: Camera, rows: int) -> np.ndarray:
        """Return the flat indices [P] of the pixels to trace with rows x rows samples.

        These are all pixels for one sample, or else the pixels whose centre or whose neighbour's centre shows the
        surface.
        """
        if rows == 1:
            return np.arange(camera.width * camera.height)
        shown = self.mesh.caster.cast(camera).mask
        return np.flatnonzero(binary_dilation(shown, np.ones((3, 3))))

    def _mirrored(self, hits: PixelHits, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
        """Return the normals [P,N,N,3] of samples, as long as weights, and which have a second bounce [P,N,N]."""
        normals, again = np.zeros((*hits.mask.shape, 3)), np.zeros(hits.mask.shape, bool)
        points, own = self._at(hits)
        bounced, turned = self._second(points, own, unit_vectors(camera.center - points))
        own[bounced] = turned
        normals[hits.mask] = own
        again[hits.mask] = np.isin(np.arange(len(own)), bounced)
        return normals / np.maximum(hits.mask.sum(axis=(1, 2)), 1)[:, None, None, None], again

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


def _key(camera: Camera, device: torch.device) -> tuple[Hashable, ...]:
    """Return the key of a camera's view in the cache."""
    return camera.K.tobytes(), camera.cam_from_world.tobytes(), camera.width, camera.height, device


def _sample_places(pixels: np.ndarray, width: int, rows: int) -> np.ndarray:
    """Return the image coordinates [P,N,N,2] of rows x rows samples of pixels [P] of an image, row by row."""
    within = (np.arange(rows) + 0.5) / rows
    x, y = (each[:, None] + within for each in (pixels % width, pixels // width))
    return np.stack(np.broadcast_arrays(x[:, None, :], y[:, :, None]), axis=-1)


def _nearest(pixels: np.ndarray, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Return the pixels [N] that are at most BESIDE off given ones [P], and which [N] of those is the nearest."""
    if not len(pixels):
        return pixels, pixels
    order = np.full((camera.height, camera.width), -1)
    order.ravel()[pixels] = np.arange(len(pixels))
    away, nearest = distance_transform_edt(order < 0, return_indices=True)
    found = np.flatnonzero(away <= BESIDE)
    return found, order[tuple(nearest)].ravel()[found]
