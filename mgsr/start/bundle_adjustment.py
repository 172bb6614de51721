"""Photometric bundle adjustment: cameras are moved to where the photographs agree.

Structure from motion locates features to about half a pixel. Much larger numbers of pixels tell the cameras more
exactly. Points of the depth maps, where a photograph has steep detail, are the anchors. All photographs that see an
anchor should show the same detail there. The anchors' depths are adjusted together with the cameras.

The detail is the logarithm of the light minus its mean around, so exposure does not change it. The normal equations
couple cameras only through each anchor's mean detail and depth, which the Schur complement eliminates.

The lens and the frame stay as they are. Half of the anchors tell whether the cameras that the other half gives are
better; if they are not, all cameras stay. The halves are cells of the scene, because the errors of neighbours are
alike. Source: photometric bundle adjustment, Delaunoy and Pollefeys 2014; Alismail, Browning and Lucey 2016.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import count

import numpy as np
from scipy import linalg, ndimage
from scipy.spatial.transform import Rotation

from mgsr.config.expert import BundleAdjustmentOptions
from mgsr.data.camera import Camera
from mgsr.data.loading import reduced_view
from mgsr.data.robust import robust_deviation
from mgsr.data.scene import View, some_of
from mgsr.data.valid_mask import filled, valid_inside
from mgsr.geometry.vectors import dots, lengths
from mgsr.parallel import map_ahead
from mgsr.shading.observations import lie_within, sample_image
from mgsr.start.scene_depths import DepthMaps
from mgsr.start.scene_points import contracted_cells

REWEIGHTINGS = 4  # of the observations in a round


@dataclass(frozen=True)
class AdjustedCameras:
    """The cameras of the training and the test views after the adjustment.

    shift: the median distance, in pixels, by which the adjustment moves the anchors in the photographs. gain: the share
    of the deviation between photographs that it removes at anchors that it did not use.
    """

    train: list[Camera]
    test: list[Camera]
    shift: float
    gain: float


def adjust_cameras(
    train: Sequence[View],
    test: Sequence[View],
    depths: DepthMaps,
    progress: Callable[[float], None] = lambda done: None,
    options: BundleAdjustmentOptions = BundleAdjustmentOptions(),
    threads: int | None = None,
) -> AdjustedCameras | None:
    """Adjust the cameras of a scene until its photographs agree about its surfaces.

    depths: the depth maps of `some_of` the training views. progress: receives the share of the work that is done, 0..1.
    All cameras together keep their position, orientation and scale.

    Returns None if the photographs do not agree better afterwards, or if too few anchors exist.
    """
    views = [*train, *test]
    pixels = sum(view.camera.width * view.camera.height for view in views)
    scale = min(1.0, (options.max_pixels / pixels) ** 0.5)
    details = list(map_ahead(lambda view: _detail(reduced_view(view, scale), options), views, threads))
    before = [view.camera.scaled(scale) for view in views]
    groups = _find_anchors(before, details, some_of(range(len(train))), depths, options, threads)
    one, other = ([group.half(which, options.apart) for group in groups] for which in range(2))
    if min(sum(len(group.places) for group in half) for half in (one, other)) < options.min_anchors:
        return None
    finished, planned = count(1), options.rounds + 2 * options.depth_rounds + options.last_rounds

    def adjusted(some: Sequence[_Anchors], cameras: Sequence[Camera], rounds: int) -> list[Camera]:
        found, anchors = list(cameras), list(some)
        for _ in range(rounds):
            found, anchors, _ = _round(anchors, found, details, options, threads, before)
            progress(next(finished) / planned)
        return found

    def deviation(some: Sequence[_Anchors], cameras: Sequence[Camera]) -> float:
        """Return the deviation between photographs at some anchors after only their depths were adjusted."""
        anchors, left = list(some), 0.0
        for _ in range(options.depth_rounds):
            _, anchors, left = _round(anchors, cameras, details, options, threads)
            progress(next(finished) / planned)
        return left

    half = adjusted(one, before, options.rounds)
    gain = 1 - deviation(other, half) / deviation(other, before)
    if gain < options.min_gain:
        return None
    poses = _in_frame_of(before, adjusted(groups, half, options.last_rounds))
    after = [replace(view.camera, cam_from_world=pose.cam_from_world) for view, pose in zip(views, poses, strict=True)]
    shifts = [
        lengths(after[group.views[0]].project(group.places)[0] - views[group.views[0]].camera.project(group.places)[0])
        for group in groups
    ]
    return AdjustedCameras(after[: len(train)], after[len(train) :], float(np.median(np.concatenate(shifts))), gain)


@dataclass(frozen=True)
class _Anchors:
    """The anchors of one depth map.

    places [P,3]: in the scene's frame. along [P,3]: the displacement for a relative change of 1 in depth. views: the
    indices of the views that see some of them, first the view of the depth map. seen [P,V] bool.
    """

    places: np.ndarray
    along: np.ndarray
    views: list[int]
    seen: np.ndarray

    def half(self, which: int, apart: float) -> _Anchors:
        """Return the anchors in every second cell of size `apart`, in contracted space; which: 0 or 1."""
        kept = contracted_cells(self.places, apart).sum(axis=1) % 2 == which
        return replace(self, places=self.places[kept], along=self.along[kept], seen=self.seen[kept])


@dataclass(frozen=True)
class _Detail:
    """The detail of a photograph [H,W] float32, and where it is known [H,W] bool."""

    values: np.ndarray
    known: np.ndarray

    def slopes(self, pixels: np.ndarray) -> np.ndarray:
        """Return the gradient [P,2], to the right and down, per pixel, at pixel coordinates [P,2]."""
        sides = np.eye(2) / 2
        return np.stack(
            [sample_image(self.values, pixels + side) - sample_image(self.values, pixels - side) for side in sides],
            axis=1,
        )


def _detail(view: View, options: BundleAdjustmentOptions) -> _Detail:
    blur, around = options.blur, options.around * options.blur
    light = np.log(filled(view.image, view.valid_mask).astype(np.float32).mean(axis=-1) / 255 + options.dark)
    values = ndimage.gaussian_filter(light, blur) - ndimage.gaussian_filter(light, around)
    valid = np.ones(values.shape, bool) if view.valid_mask is None else view.valid_mask
    return _Detail(values, valid_inside(valid, round(around)))


def _find_anchors(
    cameras: Sequence[Camera],
    details: Sequence[_Detail],
    mapped: Sequence[int],
    depths: DepthMaps,
    options: BundleAdjustmentOptions,
    threads: int | None,
) -> list[_Anchors]:
    """Choose anchors in each depth map, and find the views that see them. mapped: the indices of views with maps."""
    each = max(1, min(options.anchors, options.max_anchors // len(mapped)))
    maps = {view: number for number, view in enumerate(mapped)}
    known = {view: _without_edges(depths.known(number, cameras[view]), options) for view, number in maps.items()}
    centers = np.array([camera.center for camera in cameras])
    looking: dict[int, list[int]] = {view: [] for view in mapped}  # views without a depth map that are near
    for view in range(len(cameras)):
        if view not in maps:
            away = lengths(centers[list(mapped)] - centers[view])
            for near in np.argsort(away, kind="stable")[: options.near_views]:
                looking[mapped[near]].append(view)

    def chosen(source: int) -> _Anchors:
        camera, depth = cameras[source], known[source]
        rows, columns = _steepest(details[source], depth, each, options)
        rays = np.stack([columns + 0.5, rows + 0.5, np.ones(len(rows))], axis=1) @ np.linalg.inv(camera.K).T
        along = (rays * depth[rows, columns][:, None]) @ camera.cam_from_world[:3, :3]
        places = camera.center + along
        normals = depths.planes(maps[source], camera)[1][rows, columns]
        seen = np.zeros((len(places), len(cameras)), bool)
        for other in (*mapped, *looking[source]):
            seen[:, other] = other == source or _sees(cameras[other], places, normals, known.get(other), options)
        seen[seen.sum(axis=1) < options.min_views] = False
        shown = seen.sum(axis=0)
        most = sorted(mapped, key=lambda other: (other != source, -shown[other]))[: options.most_views]
        observers = [other for other in (*most, *looking[source]) if shown[other] or other == source]
        good = seen[:, observers].any(axis=1)
        return _Anchors(places[good], along[good], observers, seen[good][:, observers])

    return list(map_ahead(chosen, mapped, threads))


def _without_edges(depth: np.ndarray, options: BundleAdjustmentOptions) -> np.ndarray:
    """Return a depth map [H,W] with 0 near unknown pixels and near jumps, where detail belongs to two surfaces."""
    size = 2 * options.clear + 1
    least, most = ndimage.minimum_filter(depth, size), ndimage.maximum_filter(depth, size)
    return np.asarray(np.where((least > 0) & (most - least < options.jump * depth), depth, 0))


def _steepest(
    detail: _Detail, depth: np.ndarray, most: int, options: BundleAdjustmentOptions
) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows and columns of the steepest pixels with a depth, at most one in a cell and `most` in all."""
    steep = np.hypot(*np.gradient(detail.values)) * (detail.known & (depth > 0))
    cell = options.cell
    height, width = (side // cell for side in steep.shape)
    cells = steep[: height * cell, : width * cell].reshape(height, cell, width, cell).swapaxes(1, 2)
    cells = cells.reshape(height * width, cell * cell)
    best, slope = cells.argmax(axis=1), cells.max(axis=1)
    kept = np.argsort(-slope, kind="stable")[:most]
    kept = np.sort(kept[slope[kept] > options.least_slope])
    return kept // width * cell + best[kept] // cell, kept % width * cell + best[kept] % cell


def _sees(
    camera: Camera,
    places: np.ndarray,
    normals: np.ndarray,
    depth: np.ndarray | None,
    options: BundleAdjustmentOptions,
) -> np.ndarray:
    """Return which of the places [P,3] with unit normals [P,3] a view sees.

    depth [H,W]: the view's depth map; None if it has none, and whether something is in front of a place is unknown.
    """
    pixels, z = camera.project(places)
    away = camera.center - places
    seen = (z > 0) & (dots(away, normals) > options.min_cosine * lengths(away))
    seen &= (pixels >= options.border).all(axis=1)
    seen &= (pixels < np.array([camera.width, camera.height]) - options.border).all(axis=1)
    if depth is not None:
        columns, rows = pixels[seen].astype(int).T
        seen[seen] = np.abs(depth[rows, columns] / z[seen] - 1) < options.same_depth
    return np.asarray(seen)


@dataclass(frozen=True)
class _Readings:
    """What V views show of P anchors.

    values [P,V]: the detail. weights [P,V]: 0 where an anchor is not seen. by_pose [P,V,6]: the derivative by a small
    rotation and translation of the camera's frame. by_depth [P,V]: the derivative by the anchor's relative depth.
    """

    values: np.ndarray
    weights: np.ndarray
    by_pose: np.ndarray
    by_depth: np.ndarray

    @classmethod
    def empty(cls, shape: tuple[int, ...]) -> _Readings:
        """Return readings of which all weights are 0; shape: P and V."""
        return cls(np.zeros(shape), np.zeros(shape), np.zeros((*shape, 6)), np.zeros(shape))

    def write(self, rows: np.ndarray, column: int, part: Sequence[np.ndarray]) -> None:
        """Write the readings of the anchors `rows` [R] in a view's column; part: in the order of the fields."""
        for field, values in zip((self.values, self.weights, self.by_pose, self.by_depth), part, strict=True):
            field[rows, column] = values

    def residual(self) -> np.ndarray:
        """Return the detail [P,V] minus its weighted mean over the views."""
        total = np.maximum(self.weights.sum(axis=1, keepdims=True), 1e-9)
        residual: np.ndarray = self.values - (self.weights * self.values).sum(axis=1, keepdims=True) / total
        return residual


def _read(
    groups: Sequence[_Anchors], cameras: Sequence[Camera], details: Sequence[_Detail], threads: int | None
) -> list[_Readings]:
    """Sample the anchors' detail in the views that see them; each view samples the anchors of all groups at once."""
    readings = [_Readings.empty(group.seen.shape) for group in groups]
    columns: list[list[tuple[int, int, np.ndarray]]] = [[] for _ in cameras]  # a view's groups, columns and anchors
    for index, group in enumerate(groups):
        for number, view in enumerate(group.views):
            columns[view].append((index, number, np.flatnonzero(group.seen[:, number])))

    def read(view: int) -> None:
        if not columns[view]:
            return
        places = np.concatenate([groups[index].places[rows] for index, _, rows in columns[view]])
        along = np.concatenate([groups[index].along[rows] for index, _, rows in columns[view]])
        found = _read_view(places, along, cameras[view], details[view])
        ends = np.cumsum([len(rows) for _, _, rows in columns[view]])[:-1]
        parts = zip(*(np.split(each, ends) for each in found), strict=True)
        for (index, number, rows), part in zip(columns[view], parts, strict=True):
            readings[index].write(rows, number, part)

    list(map_ahead(read, range(len(cameras)), threads))
    return readings


def _read_view(places: np.ndarray, along: np.ndarray, camera: Camera, detail: _Detail) -> tuple[np.ndarray, ...]:
    """Sample anchors at places [P,3] in one view; along [P,3]: as in `_Anchors`. Returns the fields of `_Readings`."""
    pose, focal = camera.cam_from_world, np.diag(camera.K)[:2]
    places = places @ pose[:3, :3].T + pose[:3, 3]
    in_front = places[:, 2] > 0
    z = np.where(in_front, places[:, 2], 1)[:, None]
    pixels = places[:, :2] / z * focal + camera.K[:2, 2]
    across = detail.slopes(pixels) * focal / z
    slope = np.column_stack([across, -dots(across, places[:, :2]) / z[:, 0]])  # by the place in the camera's frame
    return (
        sample_image(detail.values, pixels),
        in_front & lie_within(detail.known, pixels),
        np.concatenate([np.cross(places, slope), slope], axis=1),
        dots(slope, along @ pose[:3, :3].T),
    )


@dataclass(frozen=True)
class _Equations:
    """The normal equations of P anchors that V views see, without the anchors' mean details and depths.

    matrix [6V,6V], gradient [6V]: of the views' poses. mixed [P,2,6V], local [P,2,2], local_gradient [P,2]: the parts
    of each anchor's mean detail and depth, with `local` inverted.
    """

    matrix: np.ndarray
    gradient: np.ndarray
    mixed: np.ndarray
    local: np.ndarray
    local_gradient: np.ndarray

    @classmethod
    def of(cls, readings: _Readings, prior: float) -> _Equations:
        """Set up the equations. prior: the weight of a relative change of 0 in an anchor's depth."""
        weights, points, views = readings.weights, *readings.weights.shape
        unknown = np.stack([np.ones_like(weights), readings.by_depth], axis=1)  # [P,2,V]
        weighted = unknown * weights[:, None]
        local = weighted @ unknown.swapaxes(1, 2) + np.diag([1e-9, prior])
        mixed = (weighted[..., None] * readings.by_pose[:, None]).reshape(points, 2, 6 * views)
        local_gradient = (weighted @ readings.values[..., None])[..., 0]
        inverse = np.linalg.inv(local)
        own = (readings.by_pose * weights[..., None]).transpose(1, 2, 0) @ readings.by_pose.transpose(1, 0, 2)
        matrix = -np.tensordot(mixed, inverse @ mixed, axes=([0, 1], [0, 1]))
        for view in range(views):
            matrix[6 * view : 6 * view + 6, 6 * view : 6 * view + 6] += own[view]
        gradient = np.einsum("pvi,pv->vi", readings.by_pose, weights * readings.values).ravel()
        gradient -= np.tensordot(mixed, (inverse @ local_gradient[..., None])[..., 0], axes=([0, 1], [0, 1]))
        return cls(matrix, gradient, mixed, inverse, local_gradient)

    def moved(self, anchors: _Anchors, steps: np.ndarray, limit: float) -> _Anchors:
        """Return the anchors at the depths that fit best after the views' steps [V,6]."""
        right = self.local_gradient + self.mixed @ steps.ravel()
        change = -(self.local[:, 1] * right).sum(axis=1)
        return replace(anchors, places=anchors.places + np.clip(change, -limit, limit)[:, None] * anchors.along)


def _round(
    groups: Sequence[_Anchors],
    cameras: Sequence[Camera],
    details: Sequence[_Detail],
    options: BundleAdjustmentOptions,
    threads: int | None,
    before: Sequence[Camera] | None = None,
) -> tuple[list[Camera], list[_Anchors], float]:
    """Make one Gauss-Newton step; return the cameras, the anchors, and the deviation between views before the step.

    before: the cameras as they were given, which hold the cameras; None: only the depths are adjusted.
    """
    readings, noise = _reweighted(_read(groups, cameras, details, threads), options.outlier)
    prior = (noise / options.depth_deviation) ** 2
    equations = list(map_ahead(lambda each: _Equations.of(each, prior), readings, threads))
    steps = np.zeros((len(cameras), 6))
    if before is not None:
        moved_by = np.array([_step_between(old, new) for old, new in zip(before, cameras, strict=True)])
        steps = _solved(equations, groups, moved_by, options.hold)
    pairs = zip(equations, groups, strict=True)
    moved = [equation.moved(group, steps[group.views], options.depth_limit) for equation, group in pairs]
    return [_turned(camera, step) for camera, step in zip(cameras, steps, strict=True)], moved, noise


def _reweighted(readings: Sequence[_Readings], outlier: float) -> tuple[list[_Readings], float]:
    """Lower the weights of outliers; also return the robust standard deviation of the residuals."""
    found, noise = list(readings), 0.0
    for _ in range(REWEIGHTINGS):
        residuals = [each.residual() for each in found]
        noise = robust_deviation(
            np.concatenate([residual[each.weights > 0] for residual, each in zip(residuals, readings, strict=True)])
        )
        found = [
            replace(each, weights=each.weights / (1 + (residual / (outlier * noise + 1e-9)) ** 2))
            for each, residual in zip(readings, residuals, strict=True)
        ]
    return found, noise + 1e-9


def _solved(
    equations: Sequence[_Equations], groups: Sequence[_Anchors], moved_by: np.ndarray, hold: float
) -> np.ndarray:
    """Return the steps [V,6] of all poses that solve the equations together.

    moved_by [V,6]: the steps so far. hold: the weight of a pose before all steps, as a share of what the photographs
    tell of it while all others are fixed.
    """
    views = len(moved_by)
    matrix, gradient = np.zeros((6 * views, 6 * views)), np.zeros(6 * views)
    for equation, group in zip(equations, groups, strict=True):
        at = (6 * np.array(group.views)[:, None] + np.arange(6)).ravel()
        matrix[np.ix_(at, at)] += equation.matrix
        gradient[at] += equation.gradient
    held = hold * np.diag(matrix) + 1e-9 * np.diag(matrix).max() + 1e-12
    matrix[np.diag_indices_from(matrix)] += held
    gradient += held * moved_by.ravel()
    return np.asarray(-linalg.solve(matrix, gradient, assume_a="sym").reshape(views, 6))


def _turned(camera: Camera, step: np.ndarray) -> Camera:
    """Return the camera after a small rotation and translation [6] of its frame."""
    change = np.eye(4)
    change[:3, :3], change[:3, 3] = Rotation.from_rotvec(step[:3]).as_matrix(), step[3:]
    return replace(camera, cam_from_world=change @ camera.cam_from_world)


def _step_between(before: Camera, after: Camera) -> np.ndarray:
    """Return the small rotation and translation [6] of a camera's frame that `_turned` makes."""
    change = after.cam_from_world @ before.world_from_cam
    return np.append(Rotation.from_matrix(change[:3, :3]).as_rotvec(), change[:3, 3])


def _in_frame_of(before: Sequence[Camera], after: Sequence[Camera]) -> list[Camera]:
    """Move cameras by the similarity that brings their centres, and points before them, closest to those before.

    Source: least-squares similarity, Umeyama 1991.
    """
    ahead = np.median([np.linalg.norm(camera.center) for camera in before])
    old, new = (
        np.concatenate([[each.center, each.center + ahead * each.cam_from_world[2, :3]] for each in cameras])
        for cameras in (before, after)
    )
    old_mean, new_mean = old.mean(axis=0), new.mean(axis=0)
    left, spread, right = np.linalg.svd((old - old_mean).T @ (new - new_mean))
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    rotation = left * signs @ right
    scale = float(spread @ signs / ((new - new_mean) ** 2).sum())

    def placed(camera: Camera) -> Camera:
        pose = np.eye(4)
        pose[:3, :3] = camera.cam_from_world[:3, :3] @ rotation.T
        pose[:3, 3] = -pose[:3, :3] @ (scale * rotation @ (camera.center - new_mean) + old_mean)
        return replace(camera, cam_from_world=pose)

    return [placed(camera) for camera in after]
