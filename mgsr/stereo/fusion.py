"""Fusion of depth maps into one surface inside the visual hull.

Each voxel of a grid holds a histogram of its signed distances to the surfaces that the depth maps see, up to a few
pixels, as in Zach (2008). A depth map says that the space before its surface is empty, and, more faintly, that what
lies just behind it is solid. The hull has a vote of its own, which fades inwards; nothing comes to lie outside it.

The field of distances that is sought has the least sum of absolute differences to the votes and a small total
variation. Where many votes agree, it is their median, which, unlike their mean, does not heed how far off a wrong depth
is. Where votes are few or contradict each other, the surface takes the shortest way between what is known around.

A sheet whose sides both are seen may be thinner than a voxel. So the surface is taken a voxel too far outside, where
such a sheet has two sides, and its vertices are moved back afterwards, which leaves no hole.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from mgsr.data.camera import Camera, pinhole_row
from mgsr.data.hull import Hull, hull_surface
from mgsr.geometry.displace import mean_normals
from mgsr.geometry.mesh import Mesh
from mgsr.geometry.triangles import drop_small_pieces
from mgsr.native import _fusion
from mgsr.stereo.patch_match import DepthMap

RESOLUTION = 192  # voxels along the hull's longest side, at most
FINEST = 0.7  # pixels; voxels are no smaller
COARSER = 2  # times; voxels of a first fusion, near whose surface alone the fine one is made
NEAR = 0.9  # of REACH; distance from the first fusion's surface to which the fine one is made
REACH = 3.0  # pixels; distances are cut off there
BINS = 12  # of the histogram, from -REACH to REACH
HULL_WEIGHT, HULL_FLOOR = 0.5, 0.02  # of the hull's vote near its surface and deep inside; a photograph's is at most 1
THIN = 2.0  # REACH; parts of the hull that are less than that thick are held the more by its vote, the thinner they are
THINNEST = 0.2  # of THIN; they are not held more than such parts
FADING = 2.0  # REACH; depth over which the hull's vote falls to a third
SOLID_WEIGHT = 0.05  # of a photograph's vote for what lies more than REACH behind its surface
SOLID_DEPTH = 5.0  # REACH; what lies farther behind is not voted on
POOLED = 1.0  # voxels; deviation of the Gaussian over which votes are put together
VARIATION = 0.14  # of REACH; depth of votes of weight 1 that weighs as much as the field's total variation
ROUNDS, FINE_ROUNDS = 120, 40  # of the search for the field, from the votes' median, and from the first fusion
SMOOTHED = 0.5  # voxels; the same for the distances
OUTSIDE = 1.0  # voxels outside its place at which the surface is taken
SMALLEST = 0.02  # of the area; smaller pieces are noise of stereo


def fuse(
    cameras: Sequence[Camera], maps: Sequence[DepthMap], weights: Sequence[np.ndarray], hull: Hull, pixel: float
) -> Mesh:
    """Return the fused surface; without faces where the votes leave nothing solid.

    cameras: the maps', of any sizes; weights: of the maps' pixels (`patch_match.weigh`); hull: with something inside;
    pixel: the size of the finest maps' pixels on the object.
    """
    votes = _Votes(cameras, maps, weights, REACH * pixel)
    return _surface(_fused(votes, _Grid.around(hull, FINEST * pixel), hull, _roughly_fused(votes, hull, pixel)))


def fuse_roughly(
    cameras: Sequence[Camera], maps: Sequence[DepthMap], weights: Sequence[np.ndarray], hull: Hull, pixel: float
) -> Mesh:
    """Fuse depth maps as `fuse` does, but on a grid that is COARSER times as coarse, in a fraction of the time."""
    return _surface(_roughly_fused(_Votes(cameras, maps, weights, REACH * pixel), hull, pixel))


@dataclass(frozen=True)
class _Votes:
    """Depth maps and their pixels' weights, with the distance at which they are cut off, in the scene's unit."""

    cameras: Sequence[Camera]
    maps: Sequence[DepthMap]
    weights: Sequence[np.ndarray]
    reach: float

    def on(self, points: np.ndarray) -> np.ndarray:
        """Return the histograms [P,BINS] float32 of how far behind the maps' surfaces points [P,3] lie."""
        votes = np.empty((len(points), BINS), np.float32)
        cameras = np.stack([pinhole_row(camera) for camera in self.cameras])
        depths = [found.depth for found in self.maps]
        _fusion.vote(points, cameras, depths, self.weights, self.reach, SOLID_WEIGHT, SOLID_DEPTH, votes)
        return votes


class _Grid:
    """Voxels in rows along x, y, z: origin [3] is the first one's centre, voxel their spacing, shape their numbers."""

    def __init__(self, origin: np.ndarray, voxel: float, shape: tuple[int, ...]) -> None:
        self.origin, self.voxel, self.shape = origin, voxel, shape

    @classmethod
    def around(cls, hull: Hull, finest: float) -> _Grid:
        inside = hull.reached()
        low, high = inside.min(axis=0) - 1.5 * hull.voxel, inside.max(axis=0) + 1.5 * hull.voxel
        voxel = max(float((high - low).max()) / RESOLUTION, finest)
        return cls(low, voxel, tuple(int(count) + 1 for count in np.ceil((high - low) / voxel)))

    def centers(self) -> np.ndarray:
        """Return the voxels' centres [P,3], row by row."""
        places = np.stack(np.unravel_index(np.arange(np.prod(self.shape)), self.shape), axis=1)
        return np.asarray(places * self.voxel + self.origin)

    def blurred(self, voxels: np.ndarray, values: np.ndarray, deviation: float) -> np.ndarray:
        """Blur the values [P] of the voxels `voxels` [P] by a Gaussian, with 0 elsewhere; deviation: in voxels."""
        whole = np.zeros(int(np.prod(self.shape)), np.float32)
        whole[voxels] = values
        return np.asarray(ndimage.gaussian_filter(whole.reshape(self.shape), deviation).ravel()[voxels])


def _fused(votes: _Votes, grid: _Grid, hull: Hull, rough: Hull | None) -> Hull:
    """Return the signed distances to the fused surface, positive inside, cut off at the votes' reach.

    rough: a coarser result; far from its surface it is taken over.
    """
    centers = grid.centers()
    depth = hull.values(centers).astype(np.float32) / votes.reach
    bound = np.clip(depth, -1, 1)
    near = depth > -2 * grid.voxel / votes.reach
    if rough is None:
        field = np.full(len(centers), -1, np.float32)
    else:
        field = rough.values(centers).astype(np.float32) / votes.reach
        near &= np.abs(field) < NEAR
    active = np.flatnonzero(near)
    histogram = votes.on(centers[active])
    for values in histogram.T:
        values[:] = grid.blurred(active, values, POOLED)
    fading = HULL_WEIGHT * np.exp(-np.maximum(depth[active] - 1, 0) / FADING)
    held = np.maximum(fading, HULL_FLOOR) / _thickness(depth, votes.reach, grid)[active] ** 2
    histogram[np.arange(len(active)), _bins(bound[active])] += held
    field[active] = np.minimum(_median(histogram), bound[active])
    field, most = np.clip(field, -1, 1).reshape(grid.shape), bound.reshape(grid.shape)
    strength = VARIATION * votes.reach / grid.voxel
    _fusion.regularise(histogram, active, most, strength, ROUNDS if rough is None else FINE_ROUNDS, field)
    smooth = ndimage.gaussian_filter(field, SMOOTHED)
    return Hull(np.minimum(smooth, most) * votes.reach, grid.origin, grid.voxel)


def _thickness(depth: np.ndarray, reach: float, grid: _Grid) -> np.ndarray:
    """Return about how thick [P] the hull is around each voxel, as a share of THIN from THINNEST to 1.

    depth [P]: signed depth inside the hull, in units of the votes' reach.
    """
    around = 2 * round(THIN * reach / grid.voxel) + 1
    deepest = ndimage.maximum_filter(depth.reshape(grid.shape), around, mode="nearest")
    return np.asarray(np.clip(deepest.ravel() / (THIN / 2), THINNEST, 1))


def _roughly_fused(votes: _Votes, hull: Hull, pixel: float) -> Hull:
    fine = _Grid.around(hull, FINEST * pixel)
    coarse = _Grid(fine.origin, COARSER * fine.voxel, tuple(-(-count // COARSER) + 1 for count in fine.shape))
    return _fused(votes, coarse, hull, None)


def _surface(field: Hull) -> Mesh:
    outside = OUTSIDE * field.voxel
    if not (field.field > -outside).any():
        return Mesh(np.empty((0, 3)), np.empty((0, 3), np.int64))
    whole = Mesh(*hull_surface(Hull(field.field + outside, field.origin, field.voxel)))
    mesh = drop_small_pieces(_without_voids(whole), SMALLEST)
    return mesh.moved(mesh.vertices - outside * mean_normals(mesh.double_normals, mesh.laplacian, rounds=2))


def _without_voids(mesh: Mesh) -> Mesh:
    """Return the mesh without the pieces that bound a void inside, which no photograph sees.

    Their volume is negative.
    """
    count, pieces = mesh.components
    corners = mesh.vertices[mesh.faces]
    volumes = np.einsum("fi,fi->f", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))
    return mesh.keep_faces((np.bincount(pieces, volumes, count) > 0)[pieces])


def _bins(shares: np.ndarray) -> np.ndarray:
    """Return the bins [P] of distances [P] from -1 to 1; what lies beyond falls into the outermost."""
    bins: np.ndarray = np.clip(((shares + 1) / 2 * BINS).astype(int), 0, BINS - 1)
    return bins


def _median(histogram: np.ndarray) -> np.ndarray:
    """Return the medians [P], -1..1, of histograms [P,BINS] that aren't empty."""
    sums = np.cumsum(histogram, axis=1)
    half = sums[:, -1] / 2
    at = (sums < half[:, None]).sum(axis=1).clip(0, BINS - 1)
    row = np.arange(len(histogram))
    share = (half - sums[row, at] + histogram[row, at]) / np.maximum(histogram[row, at], 1e-9)
    return np.asarray((at + np.clip(share, 0, 1)) / BINS * 2 - 1, np.float32)
