"""Filling of gaps in depth maps: image regions without contrast continue the depth around them.

The filled inverse depths minimise their second differences, which are 0 on a plane. At the image's edges, second
differences cost almost nothing, so the depth may bend or jump there.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from mgsr.config.expert import DepthFillingOptions


def fill_depth(
    inverse: np.ndarray, image: np.ndarray, options: DepthFillingOptions = DepthFillingOptions()
) -> np.ndarray:
    """Fill the gaps in a view's inverse depth map, and return the filled inverse depths [h,w].

    inverse [h,w]: 1 / camera z, 0 in the gaps. image [h,w,3]: the view's image, sRGB 0..255. The result is NaN where
    all found depths are too far away or beyond an edge.
    """
    found = inverse > 0
    if found.sum() < 3:
        return np.where(found, inverse, np.nan)
    along_x, along_y = (_smoothness(image / 255.0, axis, options) for axis in (1, 0))
    confidence, weight = _confidence(found, along_x, along_y, options), options.data_weight
    held = sparse.diags(weight * found.ravel().astype(float))
    bending = _bending(along_x, 1) + _bending(along_y, 0)
    system = (held + bending + 1e-9 * sparse.eye(found.size)).tocsc()
    filled = splu(system).solve(weight * np.where(found, inverse, 0).ravel()).reshape(found.shape)
    return np.where(found, inverse, np.where((confidence > options.min_confidence) & (filled > 0), filled, np.nan))


def _smoothness(image: np.ndarray, axis: int, options: DepthFillingOptions) -> np.ndarray:
    """Return the smoothness of an image [h,w,3] between each pixel and the next along an axis.

    image: sRGB 0..1. axis: 0 or 1. The result is [h-1,w] or [h,w-1]: 1 between equal colours, and
    `options.edge_smoothness` across an edge.
    """
    change = np.abs(np.diff(image, axis=axis)).max(axis=2)
    links: np.ndarray = np.maximum(np.exp(-((change / options.edge) ** 2)), options.edge_smoothness)
    return links


def _bending(smooth: np.ndarray, axis: int) -> sparse.csc_matrix:
    """Return the quadratic form [h*w,h*w] of the second differences along an axis.

    smooth [h-1,w] or [h,w-1]: the smoothness of the image's steps. A second difference takes the lower weight of its
    two steps.
    """
    steps = np.moveaxis(smooth, axis, -1)
    weights = np.minimum(steps[..., :-1], steps[..., 1:])
    index = np.moveaxis(_pixels(smooth, axis), axis, -1)
    parts = [(index[..., :-2], 1.0), (index[..., 1:-1], -2.0), (index[..., 2:], 1.0)]
    return _gram(parts, weights, index.size)


def _confidence(
    found: np.ndarray, along_x: np.ndarray, along_y: np.ndarray, options: DepthFillingOptions
) -> np.ndarray:
    """Return the confidence [h,w] of filled depths: about 1 at found depths, falling with distance and across edges.

    found [h,w] bool: where depth was found. along_x [h,w-1], along_y [h-1,w]: the image's smoothness.
    """
    weight = options.data_weight
    form = options.confidence_loss * sparse.eye(found.size) + sparse.diags(weight * found.ravel().astype(float))
    for smooth, axis in ((along_x, 1), (along_y, 0)):
        index = np.moveaxis(_pixels(smooth, axis), axis, -1)
        parts = [(index[..., :-1], 1.0), (index[..., 1:], -1.0)]
        form = form + _gram(parts, np.moveaxis(smooth, axis, -1), index.size)
    trust: np.ndarray = splu(form.tocsc()).solve(weight * found.ravel().astype(float)).reshape(found.shape)
    return trust


def _pixels(smooth: np.ndarray, axis: int) -> np.ndarray:
    """Return the indices [h,w] of an image's pixels.

    smooth [h-1,w] or [h,w-1]: the smoothness between the pixels along the axis, which gives the image's size.
    """
    shape = [side + (number == axis) for number, side in enumerate(smooth.shape)]
    return np.arange(int(np.prod(shape))).reshape(shape)


def _gram(parts: list[tuple[np.ndarray, float]], weights: np.ndarray, count: int) -> sparse.csc_matrix:
    """Return the quadratic form A' W A [count,count] of weighted differences between pixels.

    parts: pixel indices [...] and a factor for each term of a row of A. weights [...]: the diagonal of W.
    """
    rows = np.arange(weights.size)
    entries = [(np.full(weights.size, factor), (rows, index.ravel())) for index, factor in parts]
    matrix = sum(sparse.csc_matrix(entry, shape=(weights.size, count)) for entry in entries)
    return (matrix.T @ sparse.diags(weights.ravel()) @ matrix).tocsc()
