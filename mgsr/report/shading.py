"""Shaded pictures of a triangle mesh by ray casting (Open3D's Embree), without window and graphics driver."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mgsr.data.camera import Camera
from mgsr.geometry.mesh import Mesh
from mgsr.geometry.raycast import pixel_rays
from mgsr.open3d_library import load_open3d
from mgsr.report.pictures import Picture, SurfacePictures, color_picture, ramp

# Directions towards the lights in the camera's frame (right, up, towards the camera) and their strengths.
LIGHTS = (((-0.45, 0.65, 0.62), 0.70), ((0.75, 0.10, 0.65), 0.20), ((0.10, -0.75, 0.35), 0.10))
AMBIENT = 0.16
CLAY = np.array((0.86, 0.845, 0.82), np.float32)
SIDES = (("front", 0), ("right", 90), ("back", 180), ("left", 270))
ELEVATION = 18.0  # degrees above the horizon from which the sides are seen
MOST_PIXELS = 512  # longest side of a picture
OCCLUSION_RAYS = 12  # per sample; four samples make a pixel
OCCLUSION_REACH = 0.35  # of the mesh's radius; farther surfaces darken nothing
OCCLUSION_SPREAD = 4  # samples to either side over which occlusion is averaged on an even surface
COPLANAR_NORMAL, COPLANAR_STEP = (
    0.9,
    0.01,
)  # for an even surface: the least cosine between normals, and the largest distance off, in the mesh's radius


@dataclass(frozen=True, eq=False)
class PaintedMesh(Mesh):
    """A mesh for painting. colors [V,3]: sRGB 0..1, or None."""

    colors: np.ndarray | None = None


@dataclass(frozen=True)
class _Hits:
    """The hits of one camera's rays.

    hit [H,W] bool: which rays hit. The other arrays [P,3] belong to the P hits: points, face normals towards the
    camera, smooth normals on the same side, and colours (or None).
    """

    hit: np.ndarray
    points: np.ndarray
    facets: np.ndarray
    normals: np.ndarray
    colors: np.ndarray | None


class MeshPainter:
    """A painter of a mesh from any camera in its frame."""

    def __init__(self, mesh: PaintedMesh) -> None:
        self._mesh = mesh
        self._rays = _raycaster(mesh)
        self.center, self.radius = bounding_ball(mesh.vertices)

    def shaded(self, camera: Camera) -> np.ndarray:
        """Paint the mesh as pale clay in soft light from three sides, uint8 [H,W,4], on transparent ground.

        No side has more than MOST_PIXELS.
        """
        return self.look(camera).clay()

    def look(self, camera: Camera) -> MeshLook:
        """Cast the camera's rays, and return the view for painting."""
        camera = _limited(camera)
        # Four samples per pixel give smooth outlines.
        hits = self._cast(camera.resized(2 * camera.width, 2 * camera.height))
        light = _three_lights(hits.normals, camera) * (0.35 + 0.65 * self._openness(hits))
        return MeshLook(hits, np.clip(light, 0, 1)[:, None])

    def _cast(self, camera: Camera) -> _Hits:
        rays = pixel_rays(camera)
        origins = np.broadcast_to(camera.center.astype(np.float32), rays.shape)
        found = self._rays.cast_rays(_tensor(np.concatenate([origins, rays], axis=-1)))
        depth = found["t_hit"].numpy()
        hit = np.isfinite(depth)
        facets = _facing(found["primitive_normals"].numpy()[hit], -rays[hit])
        corners = self._mesh.faces[found["primitive_ids"].numpy()[hit].astype(np.int64)]
        second, third = found["primitive_uvs"].numpy()[hit].T
        weights = np.stack([1 - second - third, second, third], axis=1)[..., None]
        normals = (self._mesh.normals[corners] * weights).sum(1)
        colors = None if self._mesh.colors is None else (self._mesh.colors[corners] * weights).sum(1)
        unit = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
        points = origins[hit] + depth[hit][:, None] * rays[hit]
        # The face normal decides which side is visible, because at an outline the smooth normal already points away.
        return _Hits(hit, points, facets, _facing(unit, facets), colors)

    def _openness(self, hits: _Hits) -> np.ndarray:
        """Return the share [P] of directions above the surface without a near surface (ambient occlusion).

        The seed is fixed, so that the same mesh gives the same picture.
        """
        random = np.random.default_rng(0)
        starts = hits.points + 1e-3 * self.radius * hits.facets
        blocked = np.zeros(len(starts), np.float32)
        # Each step casts one ray per sample, because all rays at once would take hundreds of MiB.
        for _ in range(OCCLUSION_RAYS if len(starts) else 0):
            spread = random.standard_normal(starts.shape, np.float32)
            spread /= np.maximum(np.linalg.norm(spread, axis=1, keepdims=True), 1e-9)
            # A point on the unit sphere tangent to the surface gives cosine-weighted directions.
            rays = np.concatenate([starts, hits.normals + 0.999 * spread], axis=1)
            blocked += self._rays.test_occlusions(_tensor(rays), 0.0, OCCLUSION_REACH * self.radius).numpy()
        return _denoised(1 - blocked / OCCLUSION_RAYS, hits, COPLANAR_STEP * self.radius)


@dataclass(frozen=True)
class MeshLook:
    """One camera's view of a mesh, lit.

    Each method returns a picture uint8 [H,W,4] on transparent ground.
    """

    hits: _Hits
    light: np.ndarray

    def clay(self) -> np.ndarray:
        """Paint the mesh in one pale colour, [H,W,4] uint8, which shows the shape best."""
        return _picture(CLAY * self.light, self.hits.hit)

    def colored(self) -> np.ndarray:
        """Paint the mesh in its own colours, or in a pale colour if it has none, [H,W,4] uint8."""
        return _picture((CLAY if self.hits.colors is None else self.hits.colors) * self.light, self.hits.hit)

    def distances(self, truth: Mesh, limit: float) -> np.ndarray:
        """Paint the mesh by its distance to `truth` in the same frame, [H,W,4] uint8. From `limit` on it is darkest."""
        gap = _raycaster(truth).compute_distance(_tensor(self.hits.points)).numpy()
        return _picture(ramp(gap / limit) * (0.6 + 0.4 * self.light), self.hits.hit)


def surface_pictures(
    mesh: PaintedMesh,
    up: np.ndarray,
    viewer: np.ndarray,
    truth: Mesh | None = None,
    limit: float = 0.01,
    size: int = 320,
) -> SurfacePictures:
    """Draw the mesh from four sides, and with `truth` also its distance to the true mesh in the same frame.

    limit: the end of the colour scale, as a share of the truth's bounding radius. up [3]: a direction. viewer [3]: a
    position from which the front is visible, such as a camera's.
    """
    painter = MeshPainter(mesh)
    front = viewer - painter.center
    looks = [(name, painter.look(side_camera(mesh.vertices, up, front, angle, size))) for name, angle in SIDES]
    shaded = [Picture(name, look.clay()) for name, look in looks]
    colored = [] if mesh.colors is None else [Picture(name, look.colored()) for name, look in looks]
    distance = []
    if truth is not None:
        reach = limit * bounding_ball(truth.vertices)[1]
        distance = [Picture(name, look.distances(truth, reach)) for name, look in looks]
    return SurfacePictures(shaded, colored, distance, limit)


def side_camera(vertices: np.ndarray, up: np.ndarray, front: np.ndarray, angle: float, size: int) -> Camera:
    """Return a camera, size x size, that sees all vertices [V,3], `angle` degrees around up [3] from front [3]."""
    center, radius = bounding_ball(vertices)
    up = up / np.linalg.norm(up)
    ahead = level_front(up, front)
    turn, tilt = np.radians(angle), np.radians(ELEVATION)
    level = np.cos(turn) * ahead + np.sin(turn) * np.cross(up, ahead)
    toward = np.cos(tilt) * level + np.sin(tilt) * up
    return _look_at(center + 4.5 * radius * toward, toward, up, 4.2, size)


def level_front(up: np.ndarray, front: np.ndarray) -> np.ndarray:
    """Return the unit direction [3] perpendicular to the unit vector up [3] that is nearest to front [3].

    If front is parallel to up, the result is any perpendicular direction.
    """
    ahead = front - (front @ up) * up
    if np.linalg.norm(ahead) < 1e-6:
        ahead = np.cross(up, (1.0, 0.0, 0.0) if abs(up[0]) < 0.9 else (0.0, 1.0, 0.0))
    return np.asarray(ahead / np.linalg.norm(ahead))


def bounding_ball(points: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the centre [3] of the bounding box of points [P,3], and the largest distance from it."""
    center = (points.min(axis=0) + points.max(axis=0)) / 2
    return center, float(np.linalg.norm(points - center, axis=1).max())


def _look_at(eye: np.ndarray, toward: np.ndarray, up: np.ndarray, focal: float, size: int) -> Camera:
    """Return a square camera at eye [3] that looks along -toward [3]; focal in units of half the image's side."""
    right = np.cross(up, toward)
    right = right / np.linalg.norm(right)
    rotation = np.stack([right, -np.cross(toward, right), -toward])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, -rotation @ eye
    K = np.array([[focal * size / 2, 0, size / 2], [0, focal * size / 2, size / 2], [0, 0, 1.0]])
    return Camera(K, pose, size, size)


def _limited(camera: Camera) -> Camera:
    factor = MOST_PIXELS / max(camera.width, camera.height)
    return camera if factor >= 1 else camera.scaled(factor)


def _facing(normals: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Flip the normals [P,3] that point against the directions [P,3]."""
    return np.where((normals * directions).sum(1, keepdims=True) < 0, -normals, normals)


def _three_lights(normals: np.ndarray, camera: Camera) -> np.ndarray:
    """Return the brightness [P] of surfaces with normals [P,3] under LIGHTS, which move with the camera."""
    local = normals @ camera.cam_from_world[:3, :3].T * (1, -1, -1)
    light = np.full(len(local), AMBIENT)
    for direction, strength in LIGHTS:
        # Half-Lambert shading wraps the light around the object, so that no side is flat black.
        cosine = local @ (np.array(direction) / np.linalg.norm(direction))
        light += strength * np.clip(0.5 + 0.5 * cosine, 0, 1) ** 1.5
    return light


def _denoised(values: np.ndarray, hits: _Hits, step: float) -> np.ndarray:
    """Smooth the values [P] of a camera's hits over the even surface around each, since few rays per sample give noise.

    The means are over OCCLUSION_SPREAD samples to either side, along rows and then columns. step: the largest distance
    of samples from each other's plane.
    """

    def image(of_hits: np.ndarray) -> np.ndarray:
        """Return values [P,...] of the hits as an image float32 [H,W,...], zero elsewhere."""
        whole = np.zeros((*hits.hit.shape, *of_hits.shape[1:]), np.float32)
        whole[hits.hit] = of_hits
        return whole

    points, normals, result = image(hits.points), image(hits.normals), image(values)
    for axis in (1, 0):
        total, weight = result.copy(), np.ones_like(result)
        for far in range(1, min(OCCLUSION_SPREAD, result.shape[axis] - 1) + 1):
            here, there = [slice(None), slice(None)], [slice(None), slice(None)]
            here[axis], there[axis] = slice(None, -far), slice(far, None)
            one, other = tuple(here), tuple(there)
            apart = points[other] - points[one]
            coplanar = (
                np.einsum("hwi,hwi->hw", normals[one], normals[other]) > COPLANAR_NORMAL
            )  # false without a hit, as its normal is zero
            coplanar &= np.abs(np.einsum("hwi,hwi->hw", normals[one], apart)) < step
            for mine, others in ((one, other), (other, one)):
                total[mine] += np.where(coplanar, result[others], 0)
                weight[mine] += coplanar
        result = total / weight
    denoised: np.ndarray = result[hits.hit]
    return denoised


def _picture(colors: np.ndarray, hit: np.ndarray) -> np.ndarray:
    """Reduce the samples' colours [P,3] to a half-size picture uint8 [H,W,4].

    Alpha is the share of a pixel's four samples that hit.
    """
    height, width = hit.shape[0] // 2, hit.shape[1] // 2
    full = np.zeros((*hit.shape, 4), np.float32)
    full[hit] = np.concatenate([colors, np.ones((len(colors), 1))], axis=1)
    mean = full.reshape(height, 2, width, 2, 4).mean(axis=(1, 3))
    return color_picture(mean[..., :3] / np.maximum(mean[..., 3:], 1e-6), mean[..., 3])


def _raycaster(mesh: Mesh) -> Any:
    rays = load_open3d().t.geometry.RaycastingScene()
    core = load_open3d().core
    faces = np.ascontiguousarray(mesh.faces, np.uint32)
    rays.add_triangles(_tensor(mesh.vertices), core.Tensor(faces))
    return rays


def _tensor(values: np.ndarray) -> Any:
    """Convert an array [...] to a float32 tensor of Open3D."""
    return load_open3d().core.Tensor(np.ascontiguousarray(values, np.float32))
