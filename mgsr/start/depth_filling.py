"""Depth where stereo finds none: an image without contrast continues the depth around it.

A pixel without depth takes the inverse depth that bends least, as a plane's inverse depth does not bend at all in a
photograph. Where the image has an edge it may bend and break at no cost.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

EDGE = 0.03  # change of sRGB from a pixel to the next, 0..1, that counts as an edge
EDGE_SMOOTHNESS = 1e-6  # what an edge's bending costs, against 1 elsewhere
DATA_WEIGHT = 10.0  # of the found depths against the bending
CONFIDENCE_LOSS = 2e-3  # confidence that is lost on the way from pixel to pixel: e-fold in some twenty of them
MIN_CONFIDENCE = 0.8  # least share of its confidence that a pixel must have from found depths


def fill_depth(inverse: np.ndarray, image: np.ndarray) -> np.ndarray:
    """Fill the gaps, where it is 0, of a view's inverse depth map [h,w], and return inverse depths [h,w].

    image [h,w,3]: the view's, sRGB 0..255. NaN is returned where no found depth is near enough, or only beyond an edge.
    """
    found = inverse > 0
    if found.sum() < 3:
        return np.where(found, inverse, np.nan)
    along_x, along_y = _smoothness(image / 255.0, 1), _smoothness(image / 255.0, 0)
    confidence = _confidence(found, along_x, along_y)
    held = sparse.diags(DATA_WEIGHT * found.ravel().astype(float))
    bending = _bending(along_x, 1) + _bending(along_y, 0)
    system = (held + bending + 1e-9 * sparse.eye(found.size)).tocsc()
    filled = splu(system).solve(DATA_WEIGHT * np.where(found, inverse, 0).ravel()).reshape(found.shape)
    return np.where(found, inverse, np.where((confidence > MIN_CONFIDENCE) & (filled > 0), filled, np.nan))


def _smoothness(image: np.ndarray, axis: int) -> np.ndarray:
    """Return how smooth the image is between each pixel and the next along an axis.

    It is 1 where nothing changes, and EDGE_SMOOTHNESS across an edge. The result has the image's size, less one along
    that axis.
    """
    change = np.abs(np.diff(image, axis=axis)).max(axis=2)
    links: np.ndarray = np.maximum(np.exp(-((change / EDGE) ** 2)), EDGE_SMOOTHNESS)
    return links


def _bending(smooth: np.ndarray, axis: int) -> sparse.csc_matrix:
    """Return the quadratic form of the second differences along an axis, each weighed by its rougher step."""
    steps = np.moveaxis(smooth, axis, -1)
    weights = np.minimum(steps[..., :-1], steps[..., 1:])
    index = np.moveaxis(_pixels(smooth, axis), axis, -1)
    parts = [(index[..., :-2], 1.0), (index[..., 1:-1], -2.0), (index[..., 2:], 1.0)]
    return _gram(parts, weights, index.size)


def _confidence(found: np.ndarray, along_x: np.ndarray, along_y: np.ndarray) -> np.ndarray:
    """Return the confidence [h,w] in filled depths: 1 where depth was found, fading with distance and at edges."""
    form = CONFIDENCE_LOSS * sparse.eye(found.size) + sparse.diags(DATA_WEIGHT * found.ravel().astype(float))
    for smooth, axis in ((along_x, 1), (along_y, 0)):
        index = np.moveaxis(_pixels(smooth, axis), axis, -1)
        parts = [(index[..., :-1], 1.0), (index[..., 1:], -1.0)]
        form = form + _gram(parts, np.moveaxis(smooth, axis, -1), index.size)
    trust: np.ndarray = splu(form.tocsc()).solve(DATA_WEIGHT * found.ravel().astype(float)).reshape(found.shape)
    return trust


def _pixels(smooth: np.ndarray, axis: int) -> np.ndarray:
    """Return the indices [h,w] of an image's pixels, given an array of what lies between them along an axis."""
    shape = [side + (number == axis) for number, side in enumerate(smooth.shape)]
    return np.arange(int(np.prod(shape))).reshape(shape)


def _gram(parts: list[tuple[np.ndarray, float]], weights: np.ndarray, count: int) -> sparse.csc_matrix:
    """Return A' W A for rows that add pixels times factors, each row times its weight."""
    rows = np.arange(weights.size)
    entries = [(np.full(weights.size, factor), (rows, index.ravel())) for index, factor in parts]
    matrix = sum(sparse.csc_matrix(entry, shape=(weights.size, count)) for entry in entries)
    return (matrix.T @ sparse.diags(weights.ravel()) @ matrix).tocsc()
