"""Soft segmentation of an image by the random walker with priors (Grady 2005)."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix, diags
from scipy.sparse.linalg import cg

from mgsr.config.expert import RandomWalkerOptions

# Offsets to a neighbour by row and column, and its distance.
STEPS = ((0, 1, 1.0), (1, 0, 1.0), (1, 1, 2**0.5), (1, -1, 2**0.5))


def random_walker(
    image: np.ndarray,
    as_background: np.ndarray,
    as_object: np.ndarray,
    region: np.ndarray,
    options: RandomWalkerOptions = RandomWalkerOptions(),
) -> np.ndarray:
    """Return the object's share of each pixel, [h,w] 0..1, from label costs and the image's edges.

    image [h,w,3] sRGB 0..1. as_background, as_object [h,w]: the costs, 0 or more, of labelling a pixel background or
    object. region [h,w] bool: where the object may lie; every share outside is 0.

    The shares x minimise the sum of as_background (1 - x)^2 + as_object x^2 over the pixels, plus the squared
    differences of neighbours. Edges between unlike colours weigh less.
    """
    share, count = np.zeros(region.shape, np.float32), int(region.sum())
    if not count:
        return share
    numbers = np.full(region.shape, count)
    numbers[region] = np.arange(count)
    first, second, weight = (np.concatenate(each) for each in zip(*_edges(image, numbers, count, options), strict=True))
    pairs = np.concatenate([first, second]), np.concatenate([second, first])
    degree = np.bincount(pairs[0], np.concatenate([weight, weight]), count + 1)[:count]
    inner = (first < count) & (second < count)
    pairs = np.concatenate([first[inner], second[inner]]), np.concatenate([second[inner], first[inner]])
    links = coo_matrix((-np.concatenate([weight[inner]] * 2), pairs), shape=(count, count)).tocsr()
    asked, other = as_background[region].astype(np.float64), as_object[region].astype(np.float64)
    diagonal = asked + other + degree + 1e-6
    begin = asked / (asked + other + 1e-6)
    preconditioner, tolerance = diags(1 / diagonal), options.tolerance
    system = links + diags(diagonal)
    found, _ = cg(system, asked, x0=begin, rtol=tolerance, maxiter=options.iterations, M=preconditioner)
    share[region] = found.clip(0, 1)
    return share


def _edges(
    image: np.ndarray, numbers: np.ndarray, outside: int, options: RandomWalkerOptions
) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Return the edges between neighbours, for each offset of STEPS: both pixels' numbers [E], and weights [E].

    image [h,w,3] sRGB 0..1. numbers [h,w]: each pixel's number in the region, which is below
    `outside`; `outside` elsewhere. Edges between two pixels outside are left out.
    """
    found = []
    height, width = numbers.shape
    for down, right, distance in STEPS:
        one = slice(0, height - down), slice(max(0, -right), width - max(0, right))
        other = slice(down, height), slice(max(0, right), width + min(0, right))
        linked = (numbers[one] < outside) | (numbers[other] < outside)
        contrast = ((image[one][linked] - image[other][linked]) ** 2).sum(axis=-1) / (2 * options.contrast**2)
        weight = options.smoothness * np.exp(-contrast.astype(np.float64)) / distance
        found.append((numbers[one][linked], numbers[other][linked], weight))
    return found
