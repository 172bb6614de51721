"""Ray casting of triangle meshes, as cameras see them (Open3D's Embree)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mgsr.data.camera import Camera
from mgsr.data.valid_mask import valid_at
from mgsr.geometry.precision import middle_for_float
from mgsr.geometry.vectors import dots, lengths
from mgsr.open3d_library import load_open3d

NO_FACE = np.iinfo(np.uint32).max


@dataclass(frozen=True)
class RayHits:
    """The first hits of the rays through one camera's pixel centres.

    depth [H,W] float32: camera z, 0 for a miss. normal [H,W,3]: the unit normal of the hit face in the world frame,
    towards the camera, 0 for a miss. face [H,W] uint32: the hit face, NO_FACE for a miss.
    """

    depth: np.ndarray
    normal: np.ndarray
    face: np.ndarray

    @property
    def mask(self) -> np.ndarray:
        """Return where something is hit, [H,W] bool."""
        hit: np.ndarray = self.face != NO_FACE
        return hit


@dataclass(frozen=True)
class PixelHits:
    """The first hits of rays [...], one or several for a pixel.

    depth [...] float32: camera z, 0 for a miss. face [...] uint32: the hit face, NO_FACE for a miss. barycentric
    [...,3] float32: the barycentric coordinates of the hit.
    """

    depth: np.ndarray
    face: np.ndarray
    barycentric: np.ndarray

    @property
    def mask(self) -> np.ndarray:
        """Return where something is hit, [...] bool."""
        hit: np.ndarray = self.face != NO_FACE
        return hit


class RayCaster:
    """A mesh prepared for ray casting.

    vertices [V,3]: in any frame and unit. faces [F,3]: vertex indices.

    Embree stores positions in float32. If that is too coarse, because the vertices lie far from their frame's origin,
    rays are cast in a frame about their centre. All arguments and results stay in the vertices' frame.
    """

    def __init__(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        core = load_open3d().core
        self._middle = middle_for_float(vertices)
        self._scene = load_open3d().t.geometry.RaycastingScene()
        self._scene.add_triangles(
            core.Tensor(self._single(vertices)), core.Tensor(np.ascontiguousarray(faces, np.uint32))
        )

    def cast(self, camera: Camera) -> RayHits:
        """Return the first hits of one ray through each pixel's centre of `camera`."""
        directions = pixel_rays(camera)
        origins = np.broadcast_to(self._single(camera.center), directions.shape)
        rays = np.concatenate([origins, directions], axis=-1)
        hits = self._scene.cast_rays(load_open3d().core.Tensor(rays))
        depth, normal, face = (hits[key].numpy() for key in ("t_hit", "primitive_normals", "primitive_ids"))
        hit = face != NO_FACE
        away = dots(normal, directions) > 0
        normal = np.where(away[..., None], -normal, normal)
        return RayHits(np.where(hit, depth, 0), np.where(hit[..., None], normal, 0), face)

    def cast_pixels(self, camera: Camera, pixels: np.ndarray) -> PixelHits:
        """Return the first hits of `camera`'s rays through pixel coordinates [...,2] (centres at +0.5).

        The coordinates may lie outside the image.
        """
        local = np.ones((*pixels.shape[:-1], 3))
        local[..., :2] = (pixels - camera.K[:2, 2]) / camera.K[[0, 1], [0, 1]]
        directions = local @ camera.cam_from_world[:3, :3]
        return self.cast_rays(camera.center, directions)

    def cast_rays(self, origins: np.ndarray, directions: np.ndarray) -> PixelHits:
        """Return the first hits of rays from origins [...,3], or [3] for all, along directions [...,3].

        depth is in units of the directions' lengths.
        """
        hits = self._scene.cast_rays(_rays(self._single(origins), directions))
        depth, face, uv = (hits[key].numpy() for key in ("t_hit", "primitive_ids", "primitive_uvs"))
        return PixelHits(np.where(face != NO_FACE, depth, 0), face, _shares(uv))

    def nearest(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the points of the mesh nearest to the points [P,3].

        Each is given by its face [P] uint32 and its barycentric coordinates [P,3] float32.
        """
        found = self._scene.compute_closest_points(load_open3d().core.Tensor(self._single(points)))
        return found["primitive_ids"].numpy(), _shares(found["primitive_uvs"].numpy())

    def sees(self, camera: Camera, points: np.ndarray, gap: float, valid_mask: np.ndarray | None = None) -> np.ndarray:
        """Return the visibility [P] bool of points [P,3] in a camera.

        A visible point projects to a valid pixel of the image, and nothing occludes it. gap: the distance before the
        point at which its ray ends, so that its own surface does not occlude it. valid_mask [H,W] bool: the valid
        pixels; None: all.
        """
        inside, pixels, _ = camera.project_inside(points)
        if valid_mask is not None:
            inside = inside[valid_at(valid_mask, pixels)]
        seen = np.zeros(len(points), bool)
        seen[inside] = self.reached(camera.center, points[inside], gap)
        return seen

    def reached(self, place: np.ndarray, points: np.ndarray, gap: float) -> np.ndarray:
        """Return the visibility [P] bool of points [P,3] from a place [3].

        gap: the distance before each point within which nothing occludes it.
        """
        offsets = points - place
        distances = lengths(offsets)
        first = self._scene.cast_rays(_rays(self._single(place), offsets / distances[:, None]))["t_hit"].numpy()
        return np.asarray(first >= distances - gap)

    def _single(self, positions: np.ndarray) -> np.ndarray:
        """Convert positions [...,3] from the vertices' frame to the frame of the ray casting, as float32."""
        return np.ascontiguousarray(positions if self._middle is None else positions - self._middle, np.float32)


def _rays(origins: np.ndarray, directions: np.ndarray) -> Any:
    """Return Open3D's tensor [...,6] of rays from origins [...,3], or [3] for all, along directions [...,3]."""
    rays = np.empty((*directions.shape[:-1], 6), np.float32)
    rays[..., :3], rays[..., 3:] = origins, directions
    return load_open3d().core.Tensor(rays)


def _shares(uv: np.ndarray) -> np.ndarray:
    """Return all three barycentric coordinates [...,3] from Embree's second and third, uv [...,2]."""
    shares = np.empty((*uv.shape[:-1], 3), np.float32)
    shares[..., 1:] = uv
    shares[..., 0] = 1 - uv[..., 0] - uv[..., 1]
    return shares


def pixel_rays(camera: Camera) -> np.ndarray:
    """Return the directions [H,W,3] float32 of the rays through the pixel centres, in the world frame.

    They have a camera z of 1, so camera.center + depth * ray is the point at a depth.
    """
    x = (np.arange(camera.width) + 0.5 - camera.K[0, 2]) / camera.K[0, 0]
    y = (np.arange(camera.height) + 0.5 - camera.K[1, 2]) / camera.K[1, 1]
    right, down, ahead = camera.cam_from_world[:3, :3]
    rays: np.ndarray = (x[:, None] * right + (y[:, None] * down + ahead)[:, None]).astype(np.float32)
    return rays
