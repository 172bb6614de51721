"""A patterned plane before several cameras, and planes that may be it: what the score of a plane is tried on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from mgsr.config.expert import MatchSettings
from mgsr.data.camera import Camera
from mgsr.native import _stereo
from mgsr.native.structs import StereoPlanes, StereoViews
from mgsr.stereo.patch_match import stereo_settings
from mgsr.stereo.photographs import StereoPhotographs
from tests.mesh.shapes import looking_at_origin

SIDE, OTHERS = 64, 5
ZOOM = 3.0  # of the last camera's lens, before which some planes' pixels are too large


@dataclass(frozen=True)
class PatternedPlane:
    """A patterned plane, and a guess of it in each pixel.

    photographs: of the plane z = 0; depth [h,w] and normal [h,w,3], of the camera's frame: a plane for each pixel of
    the first; span: the least and the largest depth that count.
    """

    photographs: StereoPhotographs
    depth: np.ndarray
    normal: np.ndarray
    span: tuple[float, float]

    def judged(self, settings: MatchSettings, others: Sequence[int] = range(1, OTHERS + 1)) -> np.ndarray:
        """Score [h,w] the planes by the kernel, against all other photographs or some."""
        score = np.full((SIDE, SIDE), np.nan, np.float32)
        views = StereoViews(
            images=self.photographs.images,
            cameras=self.photographs.packed_cameras,
            view=0,
            neighbours=list(others),
            range=self.span,
        )
        planes = StereoPlanes(depth=self.depth, normal=self.normal)
        _stereo.judge(views, planes, stereo_settings(settings), score)
        return score


def patterned_plane(distance: float, seed: int) -> PatternedPlane:
    """Draw waves, a little noise and an object with holes, and photograph them from a distance.

    The lens shows as much of them from any distance. Most planes nearly fit, some tilt anywhere, and some lie outside
    the depths that count.
    """
    random = np.random.default_rng(seed)
    ways = np.array([0.3, 0.2, 1.0]) + np.concatenate([np.zeros((1, 3)), random.normal(0, 0.35, (OTHERS, 3))])
    centers = distance * ways / np.linalg.norm(ways, axis=1, keepdims=True)
    focals = 1.3 * distance / 3 * np.array([1] * OTHERS + [ZOOM])
    cameras = [looking_at_origin(center, SIDE, focal) for center, focal in zip(centers, focals, strict=True)]
    waves, phases = random.normal(0, 12, (2, 3)), random.uniform(0, 6, 3)
    images = [_drawn(camera, waves, phases, random) for camera in cameras]
    depth, normal = _planes(cameras[0], distance, random)
    return PatternedPlane(StereoPhotographs(images, cameras), depth, normal, (distance - 1.1, distance + 1.1))


def _rays(camera: Camera) -> np.ndarray:
    y, x = np.mgrid[:SIDE, :SIDE] + 0.5
    return np.asarray(np.stack([x, y, np.ones_like(x)], axis=-1) @ np.linalg.inv(camera.K).T)


def _drawn(camera: Camera, waves: np.ndarray, phases: np.ndarray, random: np.random.Generator) -> np.ndarray:
    rays = _rays(camera) @ camera.cam_from_world[:3, :3]
    places = camera.center + rays * (-camera.center[2] / rays[..., 2:])
    noise = ndimage.gaussian_filter(random.normal(0, 0.1, (SIDE, SIDE, 3)), (1, 1, 0))
    colors = 0.5 + 0.2 * np.sin(places[..., :2] @ waves + phases) + noise
    alpha = 1.2 + ndimage.gaussian_filter(random.normal(0, 14, (SIDE, SIDE, 1)), (4, 4, 0))
    drawn: np.ndarray = np.clip(np.concatenate([colors, alpha], axis=-1), 0, 1).astype(np.float32)
    return drawn


def _planes(camera: Camera, distance: float, random: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    rays, true = _rays(camera), camera.cam_from_world[:3, 2]
    depth = (camera.cam_from_world[:3, 3] @ true) / (rays @ true) + random.normal(0, 0.03, (SIDE, SIDE))
    depth[random.random(depth.shape) < 0.05] += 2
    normal = true + random.normal(0, 0.3, (SIDE, SIDE, 3))
    wild = random.random(depth.shape) < 0.1
    normal[wild] = random.normal(size=(wild.sum(), 3))
    normal *= -np.sign((normal * rays).sum(axis=-1, keepdims=True))
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    return depth.astype(np.float32), normal.astype(np.float32)
