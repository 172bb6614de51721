"""Image-based rendering of the background behind the object, from the other photographs.

Each pixel's ray ends on the support plane or on the background's surfels. The result is the median of the colours that
the nearest other cameras see at that place. It includes the object's shadow on the plane, which is the same in all
photographs.

Some places lie under the object or between its parts, and no other photograph certainly shows background there. For
such a pixel, photo-consistency decides between object and background. It compares the photographs at the background
point and at points above it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from mgsr.config.expert import BackgroundRenderOptions
from mgsr.data.camera import Camera
from mgsr.data.scene import View
from mgsr.gaussians.surfels import SurfelModel
from mgsr.geometry.raycast import pixel_rays
from mgsr.renderers.surfels import render_surfels
from mgsr.segmentation.support_plane import SupportPlane

COLUMNS = 1024  # width of the coordinate maps for cv2.remap
OUTSIDE = -9.0  # coordinate of points behind the camera, outside every image
SAME = 1e-6  # ball radii; cameras closer than this are the same camera

Window = tuple[slice, slice]


@dataclass(frozen=True)
class ExpectedBackground:
    """The background's colours in a window of a photograph.

    color [h,w,3]: the median of the samples, sRGB 0..1.
    spread [h,w]: the median absolute deviation of the samples, in the channel that differs most.
    known [h,w] bool: whether there are enough samples.
    behind, above [h,w]: the photo-consistency where the background is unknown, as a squared colour difference;
    infinite elsewhere. `behind` is measured at the background point. `above` is measured at the best of the points on
    the same ray above the support plane. Both are the `agreeing`-th smallest difference from the other photographs,
    which need not show background there.
    """

    color: np.ndarray
    spread: np.ndarray
    known: np.ndarray
    behind: np.ndarray
    above: np.ndarray


@dataclass(frozen=True)
class _Colors:
    """Colours of a photograph: values [P,3] sRGB 0..1, and which are clipped, [P,3] bool; None if `View.white` is."""

    values: np.ndarray
    clipped: np.ndarray | None

    @classmethod
    def of(cls, values: np.ndarray, white: np.ndarray | None) -> _Colors:
        """Make the colours of a photograph from its values [P,3] and `View.white` [3]."""
        return cls(values, None if white is None else values >= white / np.float32(255))


def squared_difference(
    one: np.ndarray, other: np.ndarray, one_clipped: np.ndarray | None, other_clipped: np.ndarray | None = None
) -> np.ndarray:
    """Return the squared differences [...] of the colours `one` [...,3] and `other` [...,3].

    one_clipped, other_clipped [...,3] bool: which values are clipped; a brighter value does not differ from these.
    None: none is clipped.
    """
    difference = one - other
    if one_clipped is not None:
        difference = np.where(one_clipped, np.maximum(difference, 0), difference)
    if other_clipped is not None:
        difference = np.where(other_clipped, np.minimum(difference, 0), difference)
    return np.asarray((difference**2).sum(axis=-1))


@dataclass(frozen=True)
class BackgroundSources:
    """The photographs, surfels and support plane from which the background is rendered.

    views: the photographs.
    clear [H,W] uint8, for each photograph: 255 where it certainly shows background, else 0.
    surfels: the surfels of the background.
    plane: the support plane, None without one.
    options: the options of the rendering.
    """

    views: Sequence[View]
    clear: Sequence[np.ndarray]
    surfels: SurfelModel
    plane: SupportPlane | None
    options: BackgroundRenderOptions = BackgroundRenderOptions()

    def expected(self, view: View, window: Window, asked: np.ndarray) -> ExpectedBackground:
        """Render the background in a window of a photograph, from the other photographs alone.

        asked [h,w] bool: the pixels of the window to render. All others are returned as unknown.
        """
        camera = view.camera
        places = self._places(camera, window)[asked]
        median, spread, known = self._samples(camera, places)
        unclear = _Colors.of(view.image[window][asked][~known] / np.float32(255), view.white)
        behind, above = self._consistency(camera, unclear, places[~known])
        unknown = asked.copy()
        unknown[asked] = ~known

        def spread_out(values: np.ndarray, at: np.ndarray, other: float) -> np.ndarray:
            image = np.full((*asked.shape, *values.shape[1:]), other, values.dtype)
            image[at] = values
            return image

        return ExpectedBackground(
            color=spread_out(median, asked, 0.0),
            spread=spread_out(spread, asked, 1.0),
            known=spread_out(known, asked, False),
            behind=spread_out(behind, unknown, np.inf),
            above=spread_out(above, unknown, np.inf),
        )

    def _samples(self, camera: Camera, places: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return median [P,3], spread [P] and known [P] of the background's colours at places [P,3]."""
        colors = np.full((len(places), 3, self.options.samples), np.inf, np.float32)
        count, left = np.zeros(len(places), int), np.arange(len(places))
        for index in self._order(camera):
            color, clear = self._seen(index, places[left], self.clear[index])
            shown = left[clear]
            colors[shown, :, count[shown]] = color[clear]
            count[shown] += 1
            left = left[count[left] < self.options.samples]
            if len(left) == 0:
                break
        middle = np.maximum((count - 1) // 2, 0)[:, None]
        median = np.take_along_axis(np.sort(colors, axis=-1), middle[..., None], -1)[..., 0]
        known = count >= self.options.min_samples
        median[~known] = 0
        apart = np.abs(colors - median[..., None]).max(axis=1)  # infinite where there is no sample
        spread = np.take_along_axis(np.sort(apart, axis=-1), middle, -1)[:, 0]
        return median, np.where(known, spread, np.float32(1)), known

    def _consistency(self, camera: Camera, own: _Colors, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the photo-consistency [P] of P colours at places [P,3] and above them.

        See ExpectedBackground. Both are infinite without a support plane.
        """
        above = np.full(len(places), np.inf, np.float32)
        if self.plane is None or not len(places):
            return above, above
        behind, low = self._difference(camera, own, places), self.plane.heights(places)
        steps = (camera.center - places) / np.maximum(self.plane.heights(camera.center[None]) - low, 1e-6)[:, None]
        for test in range(self.options.tests):
            height = self.options.test_height * 2**test
            raised = places + np.maximum(height - low, 0)[:, None] * steps
            above = np.minimum(above, self._difference(camera, own, raised))
        return behind, above

    def _difference(self, camera: Camera, own: _Colors, places: np.ndarray) -> np.ndarray:
        """Return the squared differences [P] of P colours from other photographs at places [P,3].

        For each place, the result is the `options.agreeing`-th smallest difference.
        """
        smallest = np.full((self.options.agreeing, len(places)), np.inf, np.float32)  # sorted, the least first
        for index in self._order(camera):
            color, inside = self._seen(index, places)
            seen = _Colors.of(color, self.views[index].white)
            apart = squared_difference(own.values, seen.values, own.clipped, seen.clipped)
            other = np.where(inside, apart, np.inf).astype(np.float32)
            for row in smallest:
                larger = np.maximum(row, other)
                np.minimum(row, other, out=row)
                other = larger
        return np.asarray(smallest[-1])

    def _order(self, camera: Camera) -> np.ndarray:
        """Return the indices [K] of the nearest other cameras, by their angle to the camera at the scene's centre."""
        centers = np.stack([camera.center, *(other.camera.center for other in self.views)])
        ways = centers / np.maximum(np.linalg.norm(centers, axis=1, keepdims=True), 1e-12)
        itself = np.linalg.norm(centers[1:] - centers[0], axis=1) < SAME
        order = np.argsort(-(ways[1:] @ ways[0]), kind="stable")
        nearest: np.ndarray = order[~itself[order]][: self.options.cameras]
        return nearest

    def _places(self, camera: Camera, window: Window) -> np.ndarray:
        """Return the background points [h,w,3], in the scene's frame, that the window's pixels show."""
        with torch.no_grad():
            shown = render_surfels(self.surfels, camera, torch.zeros(3), 0)
        depth, alpha = shown.median_depth.numpy()[window], shown.alpha.numpy()[window]
        depth = np.where((depth > 0) & (alpha > self.options.covered), depth, np.inf)
        rays = pixel_rays(camera)[window]
        if self.plane is not None:
            plane = self.plane.depth(camera.center, rays)
            hit = camera.center + rays * np.where(np.isfinite(plane), plane, 0)[..., None]
            near = np.isfinite(plane) & (np.linalg.norm(hit, axis=-1) < self.options.plane_radius)
            depth = np.where(near & (plane < self.options.plane_first * depth), plane, depth)
        depth = np.where(np.isfinite(depth), depth, self.options.far)
        return np.asarray(camera.center + rays * depth[..., None], np.float32)

    def _seen(self, index: int, places: np.ndarray, allowed: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Sample a photograph at points [P,3] of the scene.

        allowed [H,W] uint8: 255 where the photograph may be sampled; None allows all of it. Returns the colours [P,3]
        sRGB 0..1, and which of the points it shows in an allowed place, [P] bool.
        """
        import cv2  # imported here, because training needs no OpenCV

        view = self.views[index]
        matrix = _projection(view.camera)
        *across, depth = matrix[:, :3] @ places.T + matrix[:, 3:]
        # OpenCV takes maps of at most 32,767 rows or columns.
        maps = np.full((2, -(-len(places) // COLUMNS), COLUMNS), OUTSIDE, np.float32)
        pixels = maps.reshape(2, -1)[:, : len(places)]
        np.divide(across, depth, out=pixels, where=depth > 0)
        color = cv2.remap(view.image, maps[0], maps[1], cv2.INTER_LINEAR).reshape(-1, 3)[: len(places)]
        if allowed is None:
            width, height = view.camera.width, view.camera.height
            x, y = pixels
            return color / np.float32(255), (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
        clear = cv2.remap(allowed, maps[0], maps[1], cv2.INTER_LINEAR).ravel()
        return color / np.float32(255), np.asarray(clear[: len(places)] == 255)


def _projection(camera: Camera) -> np.ndarray:
    """Return the matrix [3,4] float32 from the scene's frame to homogeneous coordinates of OpenCV's pixels.

    OpenCV has the centre of the first pixel at 0.
    """
    K = camera.K.copy()
    K[:2, 2] -= 0.5
    return np.asarray(K @ camera.cam_from_world[:3], np.float32)
