"""Shaded pictures of a triangle mesh, by ray casting (Open3D's Embree): no window, no graphics driver."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mgsr.data.camera import Camera
from mgsr.metrics.raycast import pixel_rays
from mgsr.open3d_library import load_open3d
from mgsr.report.pictures import Picture, SurfacePictures, color_picture, ramp

# Directions towards the lights in the camera's frame (right, up, towards the camera) and their strengths.
LIGHTS = (((-0.45, 0.65, 0.62), 0.62), ((0.75, 0.10, 0.65), 0.20), ((0.10, -0.75, 0.35), 0.10))
AMBIENT = 0.16
CLAY = np.array((0.86, 0.845, 0.82), np.float32)
SIDES = (("front", 0), ("right", 90), ("back", 180), ("left", 270))
ELEVATION = 18.0  # degrees above the horizon from which the sides are seen
OCCLUSION_RAYS = 8  # per sample; four samples make a pixel
OCCLUSION_REACH = 0.35  # of the mesh's radius: what lies farther darkens nothing


@dataclass(frozen=True)
class TriangleMesh:
    """vertices [V,3], faces [F,3] counter-clockwise from outside, normals [V,3] unit (None: facets are shaded flat),
    colors [V,3] sRGB 0..1 or None."""

    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray | None = None
    colors: np.ndarray | None = None


@dataclass(frozen=True)
class _Hits:
    """One camera's rays: which hit [H,W] bool; and of those that did, points, normals, colours and rays, [P,3]."""

    hit: np.ndarray
    points: np.ndarray
    normals: np.ndarray
    colors: np.ndarray | None
    rays: np.ndarray


class MeshPainter:
    """A mesh, prepared to be painted from any camera in its frame."""

    def __init__(self, mesh: TriangleMesh) -> None:
        self._mesh = mesh
        self._rays = _raycaster(mesh)
        self.center, self.radius = bounding_ball(mesh.vertices)

    def shaded(self, camera: Camera, colored: bool = False) -> np.ndarray:
        """uint8 [H,W,4]: soft light from three sides on clay, or on the mesh's own colours; clear where nothing is."""
        fine = camera.resized(2 * camera.width, 2 * camera.height)
        hits = self._cast(fine)
        base = hits.colors if colored and hits.colors is not None else CLAY
        return _picture(base * self._light(hits, camera)[:, None], hits.hit)

    def distances(self, camera: Camera, truth: TriangleMesh, limit: float) -> np.ndarray:
        """uint8 [H,W,4]: the seen surface coloured by its distance to `truth`; the darkest is `limit` and more."""
        fine = camera.resized(2 * camera.width, 2 * camera.height)
        hits = self._cast(fine)
        gap = _raycaster(truth).compute_distance(_tensor(hits.points)).numpy()
        light = 0.55 + 0.45 * self._light(hits, camera)
        return _picture(ramp(gap / limit) * light[:, None], hits.hit)

    def _cast(self, camera: Camera) -> _Hits:
        rays = pixel_rays(camera)
        origins = np.broadcast_to(camera.center.astype(np.float32), rays.shape)
        found = self._rays.cast_rays(_tensor(np.concatenate([origins, rays], axis=-1)))
        depth, facets = found["t_hit"].numpy(), found["primitive_normals"].numpy()
        hit = np.isfinite(depth)
        corners = self._mesh.faces[found["primitive_ids"].numpy()[hit].astype(np.int64)]
        second, third = found["primitive_uvs"].numpy()[hit].T
        weights = np.stack([1 - second - third, second, third], axis=1)[..., None]
        normals = facets[hit] if self._mesh.normals is None else (self._mesh.normals[corners] * weights).sum(1)
        colors = None if self._mesh.colors is None else (self._mesh.colors[corners] * weights).sum(1)
        toward = np.where((normals * rays[hit]).sum(1, keepdims=True) > 0, -1, 1)
        unit = toward * normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
        return _Hits(hit, origins[hit] + depth[hit][:, None] * rays[hit], unit, colors, rays[hit])

    def _light(self, hits: _Hits, camera: Camera) -> np.ndarray:
        local = hits.normals @ camera.cam_from_world[:3, :3].T * (1, -1, -1)
        light = np.full(len(local), AMBIENT)
        for direction, strength in LIGHTS:
            # Half Lambert: the light wraps round, so that no side falls into flat black.
            cosine = local @ (np.array(direction) / np.linalg.norm(direction))
            light += strength * np.clip(0.5 + 0.5 * cosine, 0, 1) ** 1.5
        return np.clip(light * (0.35 + 0.65 * self._openness(hits)), 0, 1)

    def _openness(self, hits: _Hits) -> np.ndarray:
        """The share [P] of the directions over the surface in which nothing is near; a fixed seed, so that the same
        mesh gives the same picture."""
        if not len(hits.points):
            return np.ones(0)
        spread = np.random.default_rng(0).normal(size=(OCCLUSION_RAYS, len(hits.points), 3))
        spread /= np.linalg.norm(spread, axis=-1, keepdims=True)
        # A point on the sphere that touches the surface: directions by their cosine.
        directions = hits.normals + 0.999 * spread
        starts = np.broadcast_to(hits.points + 1e-3 * self.radius * hits.normals, directions.shape)
        rays = np.concatenate([starts, directions], axis=-1)
        blocked = self._rays.test_occlusions(_tensor(rays), tnear=0.0, tfar=OCCLUSION_REACH * self.radius)
        return 1 - blocked.numpy().mean(axis=0)


def surface_pictures(
    mesh: TriangleMesh, up: np.ndarray, front: np.ndarray, truth: TriangleMesh | None = None,
    limit: float = 0.01, size: int = 320,
) -> SurfacePictures:
    """The mesh from four sides; with `truth` (in the same frame) also its distance to it, up to `limit` of the
    truth's bounding radius. up, front: directions [3] in the mesh's frame, the latter towards the first camera."""
    painter = MeshPainter(mesh)
    cameras = [(name, side_camera(painter, up, front, angle, size)) for name, angle in SIDES]
    shaded = [Picture(name, painter.shaded(camera)) for name, camera in cameras]
    colored = [] if mesh.colors is None else [Picture(name, painter.shaded(camera, True)) for name, camera in cameras]
    distance = []
    if truth is not None:
        reach = limit * bounding_ball(truth.vertices)[1]
        distance = [Picture(name, painter.distances(camera, truth, reach)) for name, camera in cameras]
    return SurfacePictures(shaded, colored, distance, limit)


def side_camera(painter: MeshPainter, up: np.ndarray, front: np.ndarray, angle: float, size: int) -> Camera:
    """A camera size x size that sees the whole mesh from `angle` degrees round `up`, beginning at `front`."""
    up = up / np.linalg.norm(up)
    ahead = front - (front @ up) * up
    if np.linalg.norm(ahead) < 1e-6:
        ahead = np.cross(up, (1.0, 0.0, 0.0) if abs(up[0]) < 0.9 else (0.0, 1.0, 0.0))
    ahead = ahead / np.linalg.norm(ahead)
    turn, tilt = np.radians(angle), np.radians(ELEVATION)
    level = np.cos(turn) * ahead + np.sin(turn) * np.cross(up, ahead)
    toward = np.cos(tilt) * level + np.sin(tilt) * up
    return _look_at(painter.center + 4.5 * painter.radius * toward, toward, up, 4.2, size)


def up_direction(cameras: Sequence[Camera]) -> np.ndarray:
    """Where most cameras have their upper side, [3] unit; the nearest axis, if that is within 20 degrees."""
    mean = -np.sum([camera.cam_from_world[1, :3] for camera in cameras], axis=0)
    if np.linalg.norm(mean) < 1e-6:
        return np.array((0.0, 0.0, 1.0))
    mean = mean / np.linalg.norm(mean)
    axis = int(np.abs(mean).argmax())
    return np.sign(mean[axis]) * np.eye(3)[axis] if abs(mean[axis]) > np.cos(np.radians(20)) else mean


def bounding_ball(points: np.ndarray) -> tuple[np.ndarray, float]:
    """Centre [3] of the bounding box and the largest distance from there."""
    center = (points.min(axis=0) + points.max(axis=0)) / 2
    return center, float(np.linalg.norm(points - center, axis=1).max())


def _look_at(eye: np.ndarray, toward: np.ndarray, up: np.ndarray, focal: float, size: int) -> Camera:
    """A square camera at `eye` that looks along -toward; focal in halves of the image's side."""
    right = np.cross(up, toward)
    right = right / np.linalg.norm(right)
    rotation = np.stack([right, -np.cross(toward, right), -toward])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, -rotation @ eye
    K = np.array([[focal * size / 2, 0, size / 2], [0, focal * size / 2, size / 2], [0, 0, 1.0]])
    return Camera(K, pose, size, size)


def _picture(colors: np.ndarray, hit: np.ndarray) -> np.ndarray:
    """Half-size uint8 [H,W,4] of the samples' colours [P,3]; alpha is the share of a pixel's four samples that hit."""
    height, width = hit.shape[0] // 2, hit.shape[1] // 2
    full = np.zeros((*hit.shape, 4), np.float32)
    full[hit] = np.concatenate([colors, np.ones((len(colors), 1))], axis=1)
    mean = full.reshape(height, 2, width, 2, 4).mean(axis=(1, 3))
    return color_picture(mean[..., :3] / np.maximum(mean[..., 3:], 1e-6), mean[..., 3])


def _raycaster(mesh: TriangleMesh):  # type: ignore[no-untyped-def]
    rays = load_open3d().t.geometry.RaycastingScene()
    core = load_open3d().core
    faces = np.ascontiguousarray(mesh.faces, np.uint32)
    rays.add_triangles(_tensor(mesh.vertices), core.Tensor(faces))
    return rays


def _tensor(values: np.ndarray):  # type: ignore[no-untyped-def]
    return load_open3d().core.Tensor(np.ascontiguousarray(values, np.float32))
