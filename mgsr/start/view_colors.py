"""The colours of points in the views."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from mgsr.config.expert import ViewColorOptions
from mgsr.data.camera import Camera
from mgsr.data.scene import View
from mgsr.data.valid_mask import valid_at

_UNSEEN = 999


def median_colors(
    views: Sequence[View],
    positions: np.ndarray,
    normals: np.ndarray | None = None,
    tolerance: float = 0.05,
    options: ViewColorOptions = ViewColorOptions(),
) -> np.ndarray:
    """Return the colour [P,3] uint8 sRGB of each point: the median over the views that see it, without highlights.

    positions [P,3]: in the scene's frame. normals [P,3]: unit. With normals, the points are a surface: a view does not
    see points that face away, nor points that lie more than `tolerance` behind others. A point that no view sees takes
    the colour of its nearest visible neighbour.
    """
    samples = np.full((len(views), len(positions), 3), _UNSEEN, dtype=np.int16)
    for sample, view in zip(samples, views, strict=True):
        _sample_view(sample, view, positions, normals, tolerance, options)
    count = (samples[..., 0] != _UNSEEN).sum(axis=0)
    samples.sort(axis=0)
    middle = np.maximum(count - 1, 0) // 2
    colors = np.take_along_axis(samples, middle[None, :, None], axis=0)[0]
    return _fill(colors, positions, count > 0)


def _sample_view(
    sample: np.ndarray,
    view: View,
    positions: np.ndarray,
    normals: np.ndarray | None,
    tolerance: float,
    options: ViewColorOptions,
) -> None:
    """Write the view's colours into `sample` [P,3] for the points [P,3] that it sees."""
    hidden = None if normals is None else tolerance
    index, rows, cols = seen_pixels(view, positions, normals, hidden, options.depth_side, options.min_cosine)
    sample[index] = view.image[rows, cols]


def seen_pixels(
    view: View,
    positions: np.ndarray,
    normals: np.ndarray | None,
    tolerance: float | None,
    side: int,
    min_cosine: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return which of the points [P,3] a view sees, as indices [S], and the rows and columns [S] of their pixels.

    positions [P,3]: in the scene's frame. normals [P,3]: unit; points that face away are not seen; None: all points
    face the view. tolerance: the distance behind others beyond which a point is hidden; None: no point is hidden.
    side: cells along the longer side of the occlusion depth map, few enough that the points leave no gaps. min_cosine:
    the least cosine between normal and view direction. A view sees nothing at invalid pixels and outside its mask.
    """
    camera = view.camera
    pixels, depth = camera.project(positions)
    x, y = pixels.T
    seen = (depth > 0) & (x >= 0) & (x < camera.width) & (y >= 0) & (y < camera.height)
    if view.valid_mask is not None:
        seen[seen] = valid_at(view.valid_mask, pixels[seen])
    if normals is not None:
        to_camera = camera.center - positions
        cosine = (normals * to_camera).sum(axis=1) / np.linalg.norm(to_camera, axis=1)
        seen &= cosine > min_cosine
    if tolerance is not None:
        seen &= ~_hidden(camera, pixels, depth, seen, tolerance, side)
    index = np.flatnonzero(seen)
    cols, rows = pixels[index].astype(np.intp).T
    if view.alpha is not None:
        solid = view.alpha[rows, cols] > 127
        index, rows, cols = index[solid], rows[solid], cols[solid]
    return index, rows, cols


def _hidden(
    camera: Camera, pixels: np.ndarray, depth: np.ndarray, seen: np.ndarray, tolerance: float, side: int
) -> np.ndarray:
    """Return which points [P] bool lie behind others, by a depth map of the nearest point in each coarse cell.

    pixels [P,2]: pixel coordinates. depth [P]: camera z. seen [P] bool: the points that may occlude others. tolerance:
    in the scene's unit. side: cells along the depth map's side.
    """
    cells = (pixels / max(camera.width, camera.height) * side).clip(0, side - 1).astype(np.intp)
    flat = cells[:, 1] * side + cells[:, 0]
    nearest = np.full(side**2, np.inf)
    np.minimum.at(nearest, flat[seen], depth[seen])
    # A slanted surface spans a range of depths in one cell.
    slope = 2 * depth * max(camera.width, camera.height) / side / camera.K[0, 0]
    hidden: np.ndarray = depth > nearest[flat] + tolerance + slope
    return hidden


def _fill(colors: np.ndarray, positions: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Return the colours [P,3] uint8; unknown points take their nearest known neighbour's. known [P] bool."""
    if not known.any():
        return np.full(colors.shape, 128, dtype=np.uint8)
    if not known.all():
        _, nearest = cKDTree(positions[known]).query(positions[~known])
        colors[~known] = colors[known][nearest]
    return colors.astype(np.uint8)
