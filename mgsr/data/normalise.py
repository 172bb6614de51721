"""The place of a scene's unit ball: around the masks' object, or around the cameras' focus."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from mgsr.config.expert import NormalisationOptions
from mgsr.data.camera import Camera
from mgsr.data.hull import carve
from mgsr.data.scene import PointCloud, Similarity, View
from mgsr.data.silhouettes import Silhouette
from mgsr.data.valid_mask import whole_part
from mgsr.errors import SceneError


def normalisation(
    views: Sequence[View],
    points: PointCloud | None,
    silhouettes: Sequence[Silhouette],
    options: NormalisationOptions = NormalisationOptions(),
) -> Similarity:
    """Return the similarity that maps the unit ball to a ball around the object.

    silhouettes: the views' silhouettes of `options.contour_side` pixels, from masks that are not empty; none without
    masks. With masks, the ball is the smallest around the visual hull. Without masks, it lies around the cameras'
    common focus, which most of them have in view; it is then moved and shrunk to the densest points. Cameras that look
    in one direction have no such focus. Their ball holds nine tenths of the points, or else the region that they see in
    common. Raises SceneError if all cameras stand at one place, or if the masks have no common hull.
    """
    cameras = [view.camera for view in views]
    centers = np.array([camera.center for camera in cameras])
    if np.ptp(centers, axis=0).max() <= 1e-9 * max(1.0, np.abs(centers).max()):
        raise SceneError("all cameras have the same position; take photographs from different positions")
    if silhouettes:
        return Similarity(*_swapped(_masked_ball(views, silhouettes, options)))
    return Similarity(*_swapped(unmasked_ball([whole_part(view).camera for view in views], points, options)))


def focus(
    origins: np.ndarray, directions: np.ndarray, options: NormalisationOptions = NormalisationOptions()
) -> np.ndarray | None:
    """Return the point [3] nearest to rays, by least squares, without the rays that miss it by far.

    origins, directions [V,3]: of the rays; the directions are unit. Returns None if the rays are nearly parallel, or
    if the point lies behind too many of the cameras.
    """
    keep = np.ones(len(origins), dtype=bool)
    for _ in range(4):
        across = np.eye(3) - directions[keep, :, None] * directions[keep, None, :]
        total = across.sum(axis=0)
        # The least eigenvalue is the mean squared sine between the rays and their main direction.
        if np.linalg.eigvalsh(total)[0] < options.parallel * keep.sum():
            return None
        point = np.linalg.solve(total, np.einsum("vij,vj->i", across, origins[keep]))
        offset = point - origins
        miss = np.linalg.norm(np.cross(directions, offset), axis=1)
        keep = miss <= 3 * np.median(miss) + 1e-9
    ahead = (offset * directions).sum(axis=1) > 0
    return point if ahead.mean() > options.ahead else None


def smallest_ball(points: np.ndarray, steps: int = 2000) -> tuple[np.ndarray, float]:
    """Return centre [3] and radius of about the smallest ball around points [P,3] (Badoiu and Clarkson 2003)."""
    try:
        corners = points[ConvexHull(points).vertices]
    except QhullError:  # fewer than four points, or all in a plane
        corners = points
    center = corners.mean(axis=0)
    for step in range(1, steps + 1):
        farthest = corners[np.argmax(((corners - center) ** 2).sum(axis=1))]
        center = center + (farthest - center) / (step + 1)
    return center, float(np.linalg.norm(corners - center, axis=1).max())


def _masked_ball(
    views: Sequence[View], silhouettes: Sequence[Silhouette], options: NormalisationOptions
) -> tuple[np.ndarray, float]:
    """Return the centre [3] and radius of the smallest ball around the masks' visual hull.

    Raises SceneError where the masks have no common hull.
    """
    center, radii = ball_of_masks(views, options)
    radius = float(radii.max())
    for _ in range(8):
        half = options.margin * radius
        hull = carve(silhouettes, center, half, options.resolution)
        if not (hull.field > 0).any():
            raise SceneError(
                "the masks of the training views have no common visual hull; check that they are white on the object "
                "and belong to their views, and that the poses are right, or run with masks=off"
            )
        inside = hull.reached()
        cut = np.abs(inside - center).max() > half - 1.5 * hull.voxel
        found, radius_found = smallest_ball(inside)
        # Enough once the grid is about as large as the hull, so that its voxels are small against it.
        if not cut and radius_found > 0.6 * radius:
            return found, radius_found
        center, radius = found, radius * 1.6 if cut else radius_found
    return found, radius_found


def ball_of_masks(
    views: Sequence[View], options: NormalisationOptions = NormalisationOptions()
) -> tuple[np.ndarray, np.ndarray]:
    """Return the centre [3] of a ball about as large as the object, and its radius by each view [V].

    Both come from the bounding boxes of the masks, which must not be empty.
    """
    origins = np.array([view.camera.center for view in views])
    boxes = [_box(view) for view in views]
    directions, spreads = (np.array(part) for part in zip(*boxes, strict=True))
    point = focus(origins, directions, options)
    if point is None:
        point = _common_point(origins, directions, options)
    return point, np.linalg.norm(origins - point, axis=1) * spreads


def _box(view: View) -> tuple[np.ndarray, float]:
    """Return the world direction [3] to the centre of the mask's bounding box, and half its diagonal over depth.

    The mask must not be empty.
    """
    assert view.alpha is not None, "only scenes with masks reach this"
    inside = view.alpha > 127 if view.valid_mask is None else (view.alpha > 127) & view.valid_mask
    rows, cols = np.flatnonzero(inside.any(axis=1)), np.flatnonzero(inside.any(axis=0))
    K = view.camera.K
    x = (np.array([cols[0], cols[-1] + 1]) - K[0, 2]) / K[0, 0]
    y = (np.array([rows[0], rows[-1] + 1]) - K[1, 2]) / K[1, 1]
    direction = view.camera.cam_from_world[:3, :3].T @ [x.mean(), y.mean(), 1]
    return direction / np.linalg.norm(direction), float(np.hypot(np.ptp(x), np.ptp(y)) / 2)


def unmasked_ball(
    cameras: Sequence[Camera], points: PointCloud | None, options: NormalisationOptions = NormalisationOptions()
) -> tuple[np.ndarray, float]:
    """Return the centre [3] and radius of the ball around the cameras' focus, fitted to the points [P,3] in it."""
    origins = np.array([camera.center for camera in cameras])
    directions = np.array([_view_direction(camera) for camera in cameras])
    positions = None if points is None else points.positions[np.isfinite(points.positions).all(axis=1)]
    center = focus(origins, directions, options)
    if center is None:
        return _one_sided_ball(cameras, origins, directions, positions, options)
    # The median: a few close cameras must not shrink the ball to their own field of view.
    radius = float(np.median([_radius_in_view(camera, center, options) for camera in cameras]))
    if positions is None:
        return center, radius
    return _ball_of_points(positions, center, radius, options)


def _view_direction(camera: Camera) -> np.ndarray:
    """Return the unit direction [3] in the world to the middle of the image.

    It differs from the camera's axis where the image was cut out of a larger one.
    """
    if 0 <= camera.K[0, 2] <= camera.width and 0 <= camera.K[1, 2] <= camera.height:
        return np.asarray(camera.cam_from_world[2, :3])
    middle = np.linalg.solve(camera.K, [camera.width / 2, camera.height / 2, 1.0])
    return np.asarray(camera.cam_from_world[:3, :3].T @ middle / np.linalg.norm(middle))


def _ball_of_points(
    positions: np.ndarray, focus_point: np.ndarray, radius: float, options: NormalisationOptions
) -> tuple[np.ndarray, float]:
    """Return the centre [3] and radius of the ball, moved to the densest points in it and shrunk to them.

    Photographers aim beside the object, but its texture yields most of the points [P,3]. The centre stays within the
    ball's radius of focus_point [3].
    """
    center = focus_point
    for _ in range(10):
        within = positions[np.linalg.norm(positions - center, axis=1) < radius]
        if len(within) < options.min_points:
            break
        moved = np.median(within, axis=0)
        if np.linalg.norm(moved - focus_point) > radius:
            break
        center = moved
    distance = np.linalg.norm(positions - center, axis=1)
    distance = distance[distance < radius]
    if len(distance) < options.min_points:
        return center, radius
    enclosing = options.margin * np.quantile(distance, options.enclosed)
    return center, float(np.clip(enclosing, options.least_radius * radius, radius))


def _one_sided_ball(
    cameras: Sequence[Camera],
    origins: np.ndarray,
    directions: np.ndarray,
    positions: np.ndarray | None,
    options: NormalisationOptions,
) -> tuple[np.ndarray, float]:
    """Return the centre [3] and radius of the ball for cameras that look in one direction.

    origins, directions [C,3]: the cameras' viewing rays; positions [P,3] or None: points of the surface,
    which count if there are `options.min_points` of them.
    """
    if positions is not None and len(positions) >= options.min_points:
        center = np.median(positions, axis=0)
        return center, float(np.quantile(np.linalg.norm(positions - center, axis=1), options.enclosed_one_sided))
    center = _common_point(origins, directions, options)
    return center, float(np.median([_radius_in_view(camera, center, options) for camera in cameras]))


def _common_point(origins: np.ndarray, directions: np.ndarray, options: NormalisationOptions) -> np.ndarray:
    """Return a point [3] ahead of cameras that look in one direction.

    Its distance is a multiple of their largest distance from their mean.
    """
    spread = np.linalg.norm(origins - origins.mean(axis=0), axis=1).max()
    point: np.ndarray = origins.mean(axis=0) + directions.mean(axis=0) * options.ahead_one_sided * spread
    return point


def _radius_in_view(camera: Camera, center: np.ndarray, options: NormalisationOptions) -> float:
    """Return the radius of the largest ball around `center` [3] that lies wholly in the camera's image.

    It is at least a share of the distance to `center`.
    """
    local = camera.cam_from_world[:3, :3] @ center + camera.cam_from_world[:3, 3]
    K = camera.K
    edges = np.array(
        [
            [K[0, 0], 0, K[0, 2]],
            [-K[0, 0], 0, camera.width - K[0, 2]],
            [0, K[1, 1], K[1, 2]],
            [0, -K[1, 1], camera.height - K[1, 2]],
        ]
    )
    to_edges = edges @ local / np.linalg.norm(edges, axis=1)
    return float(max(to_edges.min(), options.least_in_view * np.linalg.norm(local)))


def _swapped(ball: tuple[np.ndarray, float]) -> tuple[float, np.ndarray]:
    center, radius = ball
    return radius, center
