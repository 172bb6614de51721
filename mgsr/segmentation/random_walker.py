"""Segmentation of an image by a random walker with prior costs (Grady 2005), as a soft mask."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix, diags
from scipy.sparse.linalg import cg

SMOOTHNESS = 6.0  # weight of an edge between pixels of one colour, against the costs
CONTRAST = 0.05  # sRGB 0..1 by which neighbours differ where that weight has fallen to 0.6
TOLERANCE, ITERATIONS = 1e-3, 300  # of the conjugate gradients
# Neighbours by row and column, and their distance.
STEPS = ((0, 1, 1.0), (1, 0, 1.0), (1, 1, 2**0.5), (1, -1, 2**0.5))


def random_walker(
    image: np.ndarray, as_background: np.ndarray, as_object: np.ndarray, region: np.ndarray
) -> np.ndarray:
    """Return each pixel's share of the object, [h,w] 0..1, from costs and the image's edges.

    image [h,w,3] sRGB 0..1; as_background, as_object [h,w] >= 0: what it costs to call a pixel background or object;
    region [h,w] bool: where the object may lie, outside of which every share is 0. The shares minimise the costs times
    the squared shares, and the squared differences of neighbours of like colour.
    """
    share, count = np.zeros(region.shape, np.float32), int(region.sum())
    if not count:
        return share
    numbers = np.full(region.shape, count)
    numbers[region] = np.arange(count)
    first, second, weight = (np.concatenate(each) for each in zip(*_edges(image, numbers), strict=True))
    pairs = np.concatenate([first, second]), np.concatenate([second, first])
    degree = np.bincount(pairs[0], np.concatenate([weight, weight]), count + 1)[:count]
    inner = (first < count) & (second < count)
    pairs = np.concatenate([first[inner], second[inner]]), np.concatenate([second[inner], first[inner]])
    links = coo_matrix((-np.concatenate([weight[inner]] * 2), pairs), shape=(count, count)).tocsr()
    asked, other = as_background[region].astype(np.float64), as_object[region].astype(np.float64)
    diagonal = asked + other + degree + 1e-6
    begin = asked / (asked + other + 1e-6)
    found, _ = cg(links + diags(diagonal), asked, x0=begin, rtol=TOLERANCE, maxiter=ITERATIONS, M=diags(1 / diagonal))
    share[region] = found.clip(0, 1)
    return share


def _edges(image: np.ndarray, numbers: np.ndarray) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Return, for each direction of STEPS, the numbers of two neighbours and the weight of the edge between them."""
    found = []
    height, width = numbers.shape
    outside = int(numbers.max())
    for down, right, distance in STEPS:
        one = slice(0, height - down), slice(max(0, -right), width - max(0, right))
        other = slice(down, height), slice(max(0, right), width + min(0, right))
        linked = (numbers[one] < outside) | (numbers[other] < outside)
        contrast = ((image[one][linked] - image[other][linked]) ** 2).sum(axis=-1) / (2 * CONTRAST**2)
        weight = SMOOTHNESS * np.exp(-contrast.astype(np.float64)) / distance
        found.append((numbers[one][linked], numbers[other][linked], weight))
    return found
