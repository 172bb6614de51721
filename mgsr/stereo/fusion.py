"""Depth maps fused into one surface inside the visual hull.

Each voxel of a grid holds a histogram of its signed distances to the surfaces that the depth maps see, up to a few
pixels, as in Zach (2008); a depth map says nothing of what lies farther behind its surface. The hull has a vote of its
own, which decides where the photographs tell nothing, and nothing comes to lie outside it. The surface is where the
median of the distances is zero; unlike their mean, it does not heed how far off a wrong depth is.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import ndimage

from mgsr.data.camera import Camera, pixel_size
from mgsr.data.hull import Hull
from mgsr.parallel import map_ahead
from mgsr.stereo.patch_match import DepthMap
from mgsr.stereo.photographs import StereoPhotographs

RESOLUTION = 192  # voxels along the hull's longest side, at most
FINEST = 0.7  # pixels; voxels are no smaller
REACH = 3.0  # pixels; distances are cut off there
BINS = 12  # of the histogram, from -REACH to REACH
HULL_WEIGHT = 0.5  # of the hull's vote; a photograph's is at most 1
POOLED = 1.0  # voxels; deviation of the Gaussian over which votes are put together
SMOOTHED = 0.7  # voxels; the same for the distances


def fuse(photographs: StereoPhotographs, maps: Sequence[DepthMap], weights: Sequence[np.ndarray], hull: Hull) -> Hull:
    """Return the signed distances to the fused surface, positive inside, on a grid that holds the hull closely.

    weights: of the maps' pixels (`patch_match.weigh`).
    """
    pixel = pixel_size(photographs.cameras, np.zeros(3))
    grid = _Grid.around(hull, FINEST * pixel)
    bound = np.clip(hull.values(grid.points()).astype(np.float32), -REACH * pixel, REACH * pixel)
    active = np.flatnonzero(bound > -2 * grid.voxel)
    points, histogram = grid.points(active), np.zeros((len(active), BINS), np.float32)
    votes = zip(photographs.cameras, maps, weights, strict=True)
    for voxels, distances, weight in map_ahead(lambda vote: _votes(points, *vote, REACH * pixel), votes, None):
        histogram[voxels, _bins(distances / (REACH * pixel))] += weight
    for values in histogram.T:
        values[:] = grid.blurred(active, values, POOLED)
    histogram[np.arange(len(active)), _bins(bound[active] / (REACH * pixel))] += HULL_WEIGHT
    field = np.full(len(bound), -REACH * pixel, np.float32)
    field[active] = _median(histogram) * REACH * pixel
    field = ndimage.gaussian_filter(field.reshape(grid.shape), SMOOTHED)
    return Hull(np.minimum(field, bound.reshape(grid.shape)), grid.origin, grid.voxel)


class _Grid:
    """Voxels in rows along x, y, z: origin [3] is the first one's centre, voxel their spacing, shape their numbers."""

    def __init__(self, origin: np.ndarray, voxel: float, shape: tuple[int, int, int]) -> None:
        self.origin, self.voxel, self.shape = origin, voxel, shape

    @classmethod
    def around(cls, hull: Hull, finest: float) -> _Grid:
        inside = hull.reached()
        low, high = inside.min(axis=0) - 1.5 * hull.voxel, inside.max(axis=0) + 1.5 * hull.voxel
        voxel = max(float((high - low).max()) / RESOLUTION, finest)
        x, y, z = (int(count) + 1 for count in np.ceil((high - low) / voxel))
        return cls(low, voxel, (x, y, z))

    def points(self, voxels: np.ndarray | None = None) -> np.ndarray:
        """Centres [P,3] of the voxels of these flat indices [P], or of all."""
        index = np.arange(np.prod(self.shape)) if voxels is None else voxels
        places = np.stack(np.unravel_index(index, self.shape), axis=1)
        return np.asarray(places * self.voxel + self.origin)

    def blurred(self, voxels: np.ndarray, values: np.ndarray, deviation: float) -> np.ndarray:
        """Values [P] of the voxels [P] averaged by a Gaussian, 0 elsewhere."""
        whole = np.zeros(int(np.prod(self.shape)), np.float32)
        whole[voxels] = values
        return np.asarray(ndimage.gaussian_filter(whole.reshape(self.shape), deviation).ravel()[voxels])


def _votes(
    points: np.ndarray, camera: Camera, found: DepthMap, weights: np.ndarray, reach: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of one view: the points that it tells of, by index [Q], how far behind its surface they lie [Q], and the weight
    of its word [Q]."""
    pixels, depths = camera.project(points)
    inside = (depths > 0) & (pixels >= 0).all(1) & (pixels < (camera.width, camera.height)).all(1)
    index = np.flatnonzero(inside)
    across, down = pixels[index].astype(int).T
    weight, behind = weights[down, across], depths[index] - found.depth[down, across]
    told = (weight > 0) & (behind < reach)
    return index[told], behind[told], weight[told]


def _bins(shares: np.ndarray) -> np.ndarray:
    """The bins [P] of distances [P] from -1 to 1; what lies beyond falls into the outermost."""
    return np.clip(((shares + 1) / 2 * BINS).astype(int), 0, BINS - 1)


def _median(histogram: np.ndarray) -> np.ndarray:
    """The medians [P], -1..1, of histograms [P,BINS] that aren't empty."""
    sums = np.cumsum(histogram, axis=1)
    half = sums[:, -1] / 2
    at = (sums < half[:, None]).sum(axis=1).clip(0, BINS - 1)
    row = np.arange(len(histogram))
    share = (half - sums[row, at] + histogram[row, at]) / np.maximum(histogram[row, at], 1e-9)
    return np.asarray((at + np.clip(share, 0, 1)) / BINS * 2 - 1, np.float32)
