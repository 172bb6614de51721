"""Vertex colours from the views that see a vertex."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from mgsr.mesh.views import SurfaceView, sample

SPREAD = 0.1  # a colour this far from the first mean counts half
ROUNDS = 2


def vertex_colors(
    vertices: np.ndarray, normals: np.ndarray, views: Sequence[SurfaceView], seen: np.ndarray
) -> np.ndarray:
    """Colours [V,3] float32 0..1: the mean over the views that see a vertex (seen [C,V]), where head-on views count
    more and colours far from the others' mean count less. A vertex that none sees takes its nearest neighbour's."""
    mean, total = _blend(vertices, normals, views, seen, None)
    for _ in range(ROUNDS):
        mean, _ = _blend(vertices, normals, views, seen, mean)
    known = total > 0
    if known.any() and not known.all():
        mean[~known] = mean[known][cKDTree(vertices[known]).query(vertices[~known])[1]]
    return np.clip(mean, 0, 1).astype(np.float32)


def _blend(
    vertices: np.ndarray,
    normals: np.ndarray,
    views: Sequence[SurfaceView],
    seen: np.ndarray,
    around: np.ndarray | None,
) -> tuple[np.ndarray, np.ndarray]:
    """Weighted mean colours [V,3] and the sum of the weights [V]; around [V,3] is where colours should lie."""
    sums, total = np.zeros((len(vertices), 3)), np.zeros(len(vertices))
    for view, visible in zip(views, seen, strict=True):
        index = np.flatnonzero(visible)
        pixels, _ = view.camera.project(vertices[index])
        colors = sample(view.color, pixels)
        weights = _head_on(view, vertices[index], normals[index]) * sample(view.alpha, pixels)
        if around is not None:
            off = np.linalg.norm(colors - around[index], axis=1)
            weights = weights / (1 + (off / SPREAD) ** 2)
        sums[index] += colors * weights[:, None]
        total[index] += weights
    return sums / np.maximum(total, 1e-12)[:, None], total


def _head_on(view: SurfaceView, vertices: np.ndarray, normals: np.ndarray) -> np.ndarray:
    to_camera = view.camera.center - vertices
    cosines = (to_camera * normals).sum(1) / np.linalg.norm(to_camera, axis=1)
    return np.maximum(cosines, 0.01) ** 2
