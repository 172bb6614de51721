"""Image-based rendering of the background behind the object, from the other photographs.

Each pixel's ray ends on the support plane or on the background's surfels. The result is the median of the colours that
the nearest other cameras see at that place. It includes the object's shadow on the plane, which is the same in all
photographs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from mgsr.data.camera import Camera
from mgsr.gaussians.surfels import SurfelModel
from mgsr.geometry.raycast import pixel_rays
from mgsr.renderers.surfels import render_surfels
from mgsr.segmentation.support_plane import SupportPlane

NEAREST = 24  # other cameras to sample, the most similar viewing directions first
SAMPLES = 9  # colours to collect for a pixel
LEAST_SAMPLES = 2  # with fewer, the background counts as unknown
COVERED = 0.3  # rendered opacity above which surfels form a surface
PLANE_RADIUS = 4.0  # ball radii around the scene's centre within which the support plane is visible
PLANE_FIRST = 1.05  # times the surfels' depth; the plane wins if its depth is less than this
COLUMNS = 1024  # width of the coordinate maps for cv2.remap
SAME = 1e-6  # ball radii; cameras closer than this are the same camera
FAR = 20.0  # ball radii; camera z of a pixel whose ray meets no surface

Window = tuple[slice, slice]


@dataclass(frozen=True)
class ExpectedBackground:
    """The background's colours in a window of a photograph.

    color [h,w,3]: the median of the samples, sRGB 0..1. spread [h,w]: the median absolute deviation of the samples, in
    the channel that differs most. known [h,w] bool: whether there are LEAST_SAMPLES samples.
    """

    color: np.ndarray
    spread: np.ndarray
    known: np.ndarray


@dataclass(frozen=True)
class BackgroundSources:
    """The photographs, surfels and support plane from which the background is rendered.

    cameras, images: the photographs, [H,W,3] uint8 sRGB. clear [H,W] uint8, for each photograph: 255 where it certainly
    shows background, else 0. surfels: those of the background. plane: the support plane, None without one.
    """

    cameras: Sequence[Camera]
    images: Sequence[np.ndarray]
    clear: Sequence[np.ndarray]
    surfels: SurfelModel
    plane: SupportPlane | None

    def expected(self, camera: Camera, window: Window, asked: np.ndarray) -> ExpectedBackground:
        """Render the background in a window of a camera's image, from the other photographs alone.

        asked [h,w] bool: the pixels of the window to render. All others are returned as unknown.
        """
        places = self._places(camera, window)[asked]
        colors = np.full((SAMPLES, len(places), 3), np.inf, np.float32)
        count, left = np.zeros(len(places), int), np.arange(len(places))
        for index in self._order(camera):
            color, clear = self._seen(index, places[left])
            shown = left[clear]
            colors[count[shown], shown] = color[clear]
            count[shown] += 1
            left = left[count[left] < SAMPLES]
            if len(left) == 0:
                break
        middle = np.maximum((count - 1) // 2, 0)[None]
        median = np.take_along_axis(np.sort(colors, axis=0), middle[..., None], 0)[0]
        known = count >= LEAST_SAMPLES
        median[~known] = 0
        apart = np.where(np.isfinite(colors), np.abs(colors - median), np.inf).max(axis=-1)
        spread = np.take_along_axis(np.sort(apart, axis=0), middle, 0)[0]
        found = ExpectedBackground(
            np.zeros((*asked.shape, 3), np.float32), np.ones(asked.shape, np.float32), np.zeros(asked.shape, bool)
        )
        found.color[asked], found.spread[asked], found.known[asked] = median, np.where(known, spread, 1), known
        return found

    def _order(self, camera: Camera) -> np.ndarray:
        """Return the indices [K] of the NEAREST other cameras, by their angle to the camera at the scene's centre."""
        centers = np.stack([camera.center, *(other.center for other in self.cameras)])
        ways = centers / np.maximum(np.linalg.norm(centers, axis=1, keepdims=True), 1e-12)
        itself = np.linalg.norm(centers[1:] - centers[0], axis=1) < SAME
        order = np.argsort(-(ways[1:] @ ways[0]), kind="stable")
        nearest: np.ndarray = order[~itself[order]][:NEAREST]
        return nearest

    def _places(self, camera: Camera, window: Window) -> np.ndarray:
        """Return the background points [h,w,3], in the scene's frame, that the window's pixels show."""
        with torch.no_grad():
            shown = render_surfels(self.surfels, camera, torch.zeros(3), 0)
        depth, alpha = shown.median_depth.numpy()[window], shown.alpha.numpy()[window]
        depth = np.where((depth > 0) & (alpha > COVERED), depth, np.inf)
        rays = pixel_rays(camera)[window]
        if self.plane is not None:
            slope = rays @ self.plane.normal
            with np.errstate(divide="ignore"):
                plane = -self.plane.heights(camera.center[None])[0] / slope
            plane = np.where((plane > 0) & np.isfinite(plane), plane, np.inf)
            hit = camera.center + rays * np.where(np.isfinite(plane), plane, 0)[..., None]
            near = np.isfinite(plane) & (np.linalg.norm(hit, axis=-1) < PLANE_RADIUS)
            depth = np.where(near & (plane < PLANE_FIRST * depth), plane, depth)
        return np.asarray(camera.center + rays * np.where(np.isfinite(depth), depth, FAR)[..., None])

    def _seen(self, index: int, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Sample a photograph at points [P,3] of the scene.

        Returns the colours [P,3] sRGB 0..1, and which of the points it shows as background, [P] bool.
        """
        import cv2  # late: training needs no OpenCV

        pixels, depth = self.cameras[index].project(places)
        pixels = np.where(depth[:, None] > 0, pixels - 0.5, -9)  # points behind the camera fall outside the image
        # OpenCV takes maps of at most 32,767 rows or columns.
        maps = np.full((-(-len(places) // COLUMNS) * COLUMNS, 2), -9, np.float32)
        maps[: len(places)] = pixels
        across, down = (maps[:, i].reshape(-1, COLUMNS) for i in (0, 1))
        color = cv2.remap(self.images[index], across, down, cv2.INTER_LINEAR).reshape(-1, 3)
        clear = cv2.remap(self.clear[index], across, down, cv2.INTER_LINEAR).ravel()
        return color[: len(places)] / np.float32(255), np.asarray(clear[: len(places)] == 255)
