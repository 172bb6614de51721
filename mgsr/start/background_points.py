"""Points of the background where stereo finds none, such as plain walls.

Seen from the middle of a capture, its background lies at one distance in each direction. Several distances are tried:
where a photograph shows nothing that was found already, it shows the background, and at the right distance the
photographs agree about its colour. On a plain wall they agree at many; there the neighbouring directions tell, by
iterated conditional modes (Besag 1986).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from mgsr.data.camera import Camera
from mgsr.data.loading import reduced_view
from mgsr.data.scene import PointCloud, View

DIRECTIONS = 6000  # spread evenly over the sphere; 2.6 degrees apart
NEAREST, FARTHEST, LEVELS = 1.5, 40.0, 24  # from the scene's centre; distances that are tried, evenly in their inverse
SIDE = 40  # pixels to which photographs are reduced: what is plain needs no more
VIEWS = 100  # photographs that are looked at, at most
SEEN = 3  # photographs that tell of a place
NOISE, MOST = 0.02, 0.15  # deviation of colours, sRGB 0..1, that means nothing, and one beyond which all are alike
ALIKE, STEP = 24, 2.0  # neighbouring directions, and levels off their mean that weigh as much as NOISE
ROUNDS = 40


def background_points(views: Sequence[View], found: np.ndarray) -> PointCloud:
    """Return background points in directions where photographs show none of the points found [P,3]; maybe none."""
    reduced = [_reduced_view(view, found) for view in views[:: -(-len(views) // VIEWS)]]
    directions = _directions(DIRECTIONS)
    inverse = np.linspace(1 / FARTHEST, 1 / NEAREST, LEVELS)
    tried = [_agreement(reduced, directions / each) for each in inverse]
    disagreement, colors, count = (np.stack(each, axis=1) for each in zip(*tried, strict=True))
    told = count >= SEEN
    kept = told.mean(axis=1) > 0.5
    if kept.sum() <= ALIKE:
        return PointCloud(np.zeros((0, 3)), np.zeros((0, 3), np.uint8))
    directions, disagreement, colors, told = (each[kept] for each in (directions, disagreement, colors, told))
    # Where too few photographs show a place, neighbours tell.
    disagreement = np.where(told, np.minimum(disagreement, MOST), np.median(disagreement[told]))
    level, smooth = _smooth_levels(disagreement, cKDTree(directions).query(directions, k=ALIKE + 1)[1][:, 1:])
    distance = 1 / np.interp(smooth, np.arange(LEVELS), inverse)
    # The colour is of the level nearest by at which photographs show the place.
    shown = np.where(told, np.abs(np.arange(LEVELS) - level[:, None]), LEVELS).argmin(axis=1)
    color = (255 * colors[np.arange(len(shown)), shown]).round().clip(0, 255).astype(np.uint8)
    return PointCloud(directions * distance[:, None], color)


@dataclass(frozen=True)
class _ReducedView:
    """A reduced photograph: its camera, image [h,w,3] sRGB 0..1, and where [h,w] bool it may show the background."""

    camera: Camera
    image: np.ndarray
    open: np.ndarray


def _reduced_view(view: View, found: np.ndarray) -> _ReducedView:
    small = reduced_view(view, min(1.0, SIDE / max(view.camera.width, view.camera.height)))
    free = np.ones(small.image.shape[:2], bool) if small.valid_mask is None else small.valid_mask.copy()
    _, pixels, _ = small.camera.project_inside(found)
    columns, rows = pixels.astype(np.intp).T
    free[rows, columns] = False
    return _ReducedView(small.camera, small.image / 255.0, free)


def _directions(count: int) -> np.ndarray:
    """Return `count` unit vectors [count,3], spread evenly (a Fibonacci lattice)."""
    index = np.arange(count) + 0.5
    z, turn = 1 - 2 * index / count, np.pi * (1 + 5**0.5) * index
    ring = np.sqrt(1 - z * z)
    return np.stack([ring * np.cos(turn), ring * np.sin(turn), z], axis=1)


def _agreement(reduced: Sequence[_ReducedView], places: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the deviation [D] of the photographs' colours at places [D,3], their mean [D,3], and their number [D]."""
    count, total, squares = np.zeros(len(places)), np.zeros((len(places), 3)), np.zeros((len(places), 3))
    for view in reduced:
        index, pixels, _ = view.camera.project_inside(places)
        columns, rows = pixels.astype(np.intp).T
        free = view.open[rows, columns]
        index, color = index[free], view.image[rows[free], columns[free]]
        count[index] += 1
        total[index] += color
        squares[index] += color * color
    several = np.maximum(count, 2)[:, None]
    mean = total / np.maximum(count, 1)[:, None]
    variance = (squares - several * mean * mean).clip(0) / (several - 1)
    return np.sqrt(variance.sum(axis=1)), mean, count


def _smooth_levels(disagreement: np.ndarray, neighbours: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Choose the distance level [D] of each direction: of low disagreement [D,L], and like its neighbours' [D,k].

    Also returns the mean [D] of the level and its neighbours', for positions between the levels.
    """
    cost = (disagreement + disagreement[neighbours].mean(axis=1)) / (2 * NOISE)
    levels = np.arange(cost.shape[1])
    level = cost.argmin(axis=1)
    for _ in range(ROUNDS):
        beside = level[neighbours].mean(axis=1)
        level = (cost + np.square((levels - beside[:, None]) / STEP)).argmin(axis=1)
    return level, (level + level[neighbours].mean(axis=1)) / 2
