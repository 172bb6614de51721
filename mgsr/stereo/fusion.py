"""Fusion of depth maps into one surface inside the visual hull.

Each voxel holds a histogram of its truncated signed distances to the surfaces in the depth maps, as in Zach (2008). A
depth map votes that the space before its surface is empty and, with less weight, that the space behind it is solid. The
hull votes too, with a weight that fades inwards. It also bounds the surface.

The fused distance field minimises the sum of absolute differences to the votes plus its total variation (TV-L1). Where
many votes agree, it is their median, which is robust to wrong depths. Where votes are few or contradict each other, the
total variation gives the smallest surface that joins the parts around.

A sheet that is seen from both sides may be thinner than a voxel. So the surface is extracted one voxel outside its
place, where the sheet has two sides, and its vertices are moved back afterwards. This leaves no hole.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from mgsr.config.expert import FusionOptions
from mgsr.data.camera import Camera, pinhole_row
from mgsr.data.hull import Hull, hull_surface
from mgsr.geometry.displace import mean_normals
from mgsr.geometry.mesh import Mesh
from mgsr.geometry.triangles import drop_small_pieces
from mgsr.native import _fusion
from mgsr.native.structs import VotingMaps
from mgsr.parallel import map_ahead
from mgsr.stereo.patch_match import DepthMap

MARGIN = 1.5  # voxels of the hull, between the hull and the grid's border


def fuse(
    cameras: Sequence[Camera],
    maps: Sequence[DepthMap],
    weights: Sequence[np.ndarray],
    hull: Hull,
    pixel: float,
    options: FusionOptions = FusionOptions(),
) -> Mesh:
    """Fuse depth maps to a surface in the scene's frame; it has no faces if the votes leave nothing solid.

    cameras, maps: a camera for each depth map, of any sizes. weights [h,w] 0..1: the confidence in each map's pixels
    (`patch_match.weigh`). hull: the visual hull, not empty. pixel: the size of the finest maps' pixels on the object,
    in the scene's unit.
    """
    votes = _Votes(cameras, maps, weights, options.reach * pixel, options)
    rough = _roughly_fused(votes, hull, pixel)
    return _surface(_fused(votes, _Grid.around(hull, pixel, options), hull, rough), options)


def fuse_roughly(
    cameras: Sequence[Camera],
    maps: Sequence[DepthMap],
    weights: Sequence[np.ndarray],
    hull: Hull,
    pixel: float,
    options: FusionOptions = FusionOptions(),
) -> Mesh:
    """Fuse depth maps as `fuse` does, but faster, on a grid with `options.coarser` times larger voxels.

    The arguments are those of `fuse`; weights [h,w].
    """
    votes = _Votes(cameras, maps, weights, options.reach * pixel, options)
    return _surface(_roughly_fused(votes, hull, pixel), options)


@dataclass(frozen=True)
class _Votes:
    """Depth maps that vote on signed distances.

    weights [h,w] 0..1: of each map's pixels. reach: the truncation of the distances, in the scene's unit.
    """

    cameras: Sequence[Camera]
    maps: Sequence[DepthMap]
    weights: Sequence[np.ndarray]
    reach: float
    options: FusionOptions

    def on(self, points: np.ndarray) -> np.ndarray:
        """Return the histograms [P,bins] float32 of the depth maps' votes on the signed distances of points [P,3]."""
        votes = np.empty((len(points), self.options.bins), np.float32)
        maps = VotingMaps(
            cameras=np.stack([pinhole_row(camera) for camera in self.cameras]),
            depths=[found.depth for found in self.maps],
            weights=self.weights,
        )
        _fusion.vote(points, maps, self.reach, self.options.solid_weight, self.options.solid_depth, votes)
        return votes


class _Grid:
    """A grid of voxels along x, y and z.

    origin [3]: the first voxel's centre, in the scene's frame. voxel: the spacing, in the scene's unit. shape: the
    number of voxels along each axis.
    """

    def __init__(self, origin: np.ndarray, voxel: float, shape: tuple[int, ...]) -> None:
        self.origin, self.voxel, self.shape = origin, voxel, shape

    @classmethod
    def around(cls, hull: Hull, pixel: float, options: FusionOptions) -> _Grid:
        """Make a grid around a hull. pixel: the size of a pixel on the object, in the scene's unit."""
        inside = hull.reached()
        low, high = inside.min(axis=0) - MARGIN * hull.voxel, inside.max(axis=0) + MARGIN * hull.voxel
        voxel = max(float((high - low).max()) / options.resolution, options.finest * pixel)
        return cls(low, voxel, tuple(int(count) + 1 for count in np.ceil((high - low) / voxel)))

    def centers(self) -> np.ndarray:
        """Return the voxels' centres [P,3] in the scene's frame, in C order."""
        places = np.stack(np.unravel_index(np.arange(np.prod(self.shape)), self.shape), axis=1)
        return np.asarray(places * self.voxel + self.origin)

    def blurred(self, voxels: np.ndarray, values: np.ndarray, deviation: float) -> np.ndarray:
        """Blur the values [P] of the voxels with flat indices `voxels` [P] by a Gaussian; other voxels count as 0.

        deviation: the Gaussian's standard deviation, in voxels. Returns values [P].
        """
        whole = np.zeros(int(np.prod(self.shape)), np.float32)
        whole[voxels] = values
        return np.asarray(ndimage.gaussian_filter(whole.reshape(self.shape), deviation).ravel()[voxels])


def _fused(votes: _Votes, grid: _Grid, hull: Hull, rough: Hull | None) -> Hull:
    """Return the signed distances to the fused surface, positive inside, truncated at the votes' reach.

    rough: the result of a coarser fusion, which is kept outside the band around its surface; None: there is none.
    """
    centers, options = grid.centers(), votes.options
    depth = hull.values(centers).astype(np.float32) / votes.reach
    bound = np.clip(depth, -1, 1)
    near = depth > -2 * grid.voxel / votes.reach
    if rough is None:
        field = np.full(len(centers), -1, np.float32)
    else:
        field = rough.values(centers).astype(np.float32) / votes.reach
        near &= np.abs(field) < options.band
    active = np.flatnonzero(near)
    histogram = votes.on(centers[active])
    blurred = map_ahead(lambda values: grid.blurred(active, values, options.pooled), histogram.T, None)
    for values, pooled in zip(histogram.T, blurred, strict=True):
        values[:] = pooled
    fading = options.hull_weight * np.exp(-np.maximum(depth[active] - 1, 0) / options.fading)
    held = np.maximum(fading, options.hull_floor) / _thickness(depth, votes, grid)[active] ** 2
    histogram[np.arange(len(active)), _bins(bound[active], options.bins)] += held
    field[active] = np.minimum(_median(histogram), bound[active])
    field, most = np.clip(field, -1, 1).reshape(grid.shape), bound.reshape(grid.shape)
    strength = options.variation * votes.reach / grid.voxel
    rounds = options.rounds if rough is None else options.fine_rounds
    _fusion.regularise(histogram, active, most, strength, rounds, field)
    smooth = ndimage.gaussian_filter(field, options.smoothed)
    return Hull(np.minimum(smooth, most) * votes.reach, grid.origin, grid.voxel)


def _thickness(depth: np.ndarray, votes: _Votes, grid: _Grid) -> np.ndarray:
    """Return the hull's approximate thickness [P] around each voxel, as a share of `thin`, limited to `thinnest`..1.

    depth [P]: the voxels' signed depth inside the hull, in units of the votes' reach.
    """
    options = votes.options
    around = 2 * round(options.thin * votes.reach / grid.voxel) + 1
    deepest = ndimage.maximum_filter(depth.reshape(grid.shape), around, mode="nearest")
    return np.asarray(np.clip(deepest.ravel() / (options.thin / 2), options.thinnest, 1))


def _roughly_fused(votes: _Votes, hull: Hull, pixel: float) -> Hull:
    fine, times = _Grid.around(hull, pixel, votes.options), votes.options.coarser
    coarse = _Grid(fine.origin, times * fine.voxel, tuple(-(-count // times) + 1 for count in fine.shape))
    return _fused(votes, coarse, hull, None)


def _surface(field: Hull, options: FusionOptions) -> Mesh:
    outside = options.outside * field.voxel
    if not (field.field > -outside).any():
        return Mesh(np.empty((0, 3)), np.empty((0, 3), np.int64))
    whole = Mesh(*hull_surface(Hull(field.field + outside, field.origin, field.voxel)))
    mesh = drop_small_pieces(_without_voids(whole), options.min_piece)
    return mesh.moved(mesh.vertices - outside * mean_normals(mesh.double_normals, mesh.laplacian, rounds=2))


def _without_voids(mesh: Mesh) -> Mesh:
    """Drop the pieces that bound an inner void, which no photograph sees. Their signed volume is negative."""
    count, pieces = mesh.components
    corners = mesh.vertices[mesh.faces]
    volumes = np.einsum("fi,fi->f", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))
    return mesh.keep_faces((np.bincount(pieces, volumes, count) > 0)[pieces])


def _bins(shares: np.ndarray, count: int) -> np.ndarray:
    """Return the bins [P], of `count` in all, of distances [P] in -1..1; those beyond fall into the outermost bins."""
    bins: np.ndarray = np.clip(((shares + 1) / 2 * count).astype(int), 0, count - 1)
    return bins


def _median(histogram: np.ndarray) -> np.ndarray:
    """Return the medians [P], -1..1, of histograms [P,bins] that are not empty."""
    bins = histogram.shape[1]
    sums = np.cumsum(histogram, axis=1)
    half = sums[:, -1] / 2
    at = (sums < half[:, None]).sum(axis=1).clip(0, bins - 1)
    row = np.arange(len(histogram))
    share = (half - sums[row, at] + histogram[row, at]) / np.maximum(histogram[row, at], 1e-9)
    return np.asarray((at + np.clip(share, 0, 1)) / bins * 2 - 1, np.float32)
