"""Photographs prepared for stereo: reduced in size, with the mask as a fourth channel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mgsr.config.expert import StereoConfig
from mgsr.data.camera import Camera, pinhole_row
from mgsr.data.images import reduce_area
from mgsr.data.scene import View, some_of
from mgsr.data.valid_mask import filled, valid_mean
from mgsr.parallel import map_ahead


@dataclass(frozen=True)
class StereoPhotographs:
    """Photographs prepared for stereo.

    images [h,w,4] float32, for each view: sRGB 0..1, and the object's share of the pixel, which is 0 at invalid pixels.
    cameras: of the same sizes.
    """

    images: list[np.ndarray]
    cameras: list[Camera]

    @cached_property
    def packed_cameras(self) -> np.ndarray:
        """Return the cameras as one array [N,16] float32 of `pinhole_row` rows."""
        return np.array([pinhole_row(camera) for camera in self.cameras], np.float32)

    def neighbours(self, view: int, count: int, apart: float, farthest: float) -> list[int]:
        """Return the indices of at most `count` neighbours of `view`, by `neighbours`; angles in degrees."""
        return neighbours(self.cameras, view, count, apart, farthest)

    def reduced(self, share: float) -> StereoPhotographs:
        """Reduce the photographs' sides by the factor `share`; each new pixel is the mean over its area."""
        cameras = [camera.scaled(share, least=2) for camera in self.cameras]
        pairs = zip(self.images, cameras, strict=True)
        return StereoPhotographs([reduce_area(image, each.width, each.height) for image, each in pairs], cameras)


def neighbours(cameras: Sequence[Camera], view: int, count: int, apart: float, farthest: float) -> list[int]:
    """Return the indices of at most `count` neighbours of camera `view`, those nearest to `apart` degrees away first.

    Angles are between the cameras' directions from the scene's centre, in degrees. Cameras at `farthest` or more are
    excluded.
    """
    away = np.array([camera.center for camera in cameras])
    away /= np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-9)
    angles = np.degrees(np.arccos(np.clip(away @ away[view], -1, 1)))
    angles[view] = np.inf
    order = np.argsort(np.abs(angles - apart), kind="stable")[:count]
    return [int(each) for each in order if angles[each] < farthest]


def stereo_photographs(views: Sequence[View], max_pixels: int = StereoConfig().max_object_pixels) -> StereoPhotographs:
    """Prepare `some_of` a scene's views, reduced so that at most `max_pixels` show the object."""
    some = some_of(views)
    area = sum(float((view.alpha > 127).sum()) if view.alpha is not None else view.image[..., 0].size for view in some)
    shrink = min(1.0, (max_pixels / max(area, 1)) ** 0.5)
    images, cameras = zip(*map_ahead(lambda view: _prepared(view, shrink), some, None), strict=True)
    return StereoPhotographs(list(images), list(cameras))


def _prepared(view: View, shrink: float) -> tuple[np.ndarray, Camera]:
    """Return a view's image [h,w,4] for stereo and its camera, both reduced by the factor `shrink`."""
    camera, known = view.camera, view.valid_mask
    alpha = np.full(view.image.shape[:2], 255, np.uint8) if view.alpha is None else view.alpha
    pixels: np.ndarray = np.concatenate([view.image, alpha[..., None]], axis=-1).astype(np.float32)
    if shrink < 1:
        camera = camera.scaled(shrink, least=2)
        pixels, known = valid_mean(pixels, known, lambda each: reduce_area(each, camera.width, camera.height))
    pixels = filled(pixels, known).astype(np.float32) / 255
    if known is not None:
        pixels[..., 3] = np.where(known, pixels[..., 3], 0)
    return np.ascontiguousarray(pixels, np.float32), camera
