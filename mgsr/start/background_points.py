"""Background points where stereo finds none, such as on plain walls.

The background has one distance in each direction from the centre of a capture. Several distances are tried. At the
right one, the photographs agree about the background's colour. Pixels that show a known point are left out. On a plain
wall the photographs agree at many distances. There the neighbouring directions decide, by iterated conditional modes
(Besag 1986).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from mgsr.config.expert import BackgroundPointOptions
from mgsr.data.loading import reduced_view
from mgsr.data.scene import PointCloud, View
from mgsr.data.valid_mask import valid_at


def background_points(
    views: Sequence[View], found: np.ndarray, options: BackgroundPointOptions = BackgroundPointOptions()
) -> PointCloud:
    """Return background points in the directions where photographs show no found points; the result may be empty.

    found [P,3]: in the scene's frame, as are the new points.
    """
    reduced = [_background(view, found, options.side) for view in views[:: -(-len(views) // options.views)]]
    directions = _directions(options.directions)
    inverse, levels = np.linspace(1 / options.farthest, 1 / options.nearest, options.levels), np.arange(options.levels)
    tried = [_agreement(reduced, directions / each) for each in inverse]
    deviation, colors, count = (np.stack(each, axis=1) for each in zip(*tried, strict=True))
    shown_enough = count >= options.seen
    kept = shown_enough.mean(axis=1) > 0.5
    if kept.sum() <= options.neighbours:
        return PointCloud(np.zeros((0, 3)), np.zeros((0, 3), np.uint8))
    directions, deviation, colors, shown_enough = (each[kept] for each in (directions, deviation, colors, shown_enough))
    # A neutral cost where too few photographs show a place, so that the neighbours decide.
    deviation = np.where(shown_enough, np.minimum(deviation, options.most), np.median(deviation[shown_enough]))
    neighbours = cKDTree(directions).query(directions, k=options.neighbours + 1)[1][:, 1:]
    level, smooth = _smooth_levels(deviation, neighbours, options)
    distance = 1 / np.interp(smooth, levels, inverse)
    # The colour comes from the nearest level that enough photographs show.
    shown = np.where(shown_enough, np.abs(levels - level[:, None]), len(levels)).argmin(axis=1)
    color = (255 * colors[np.arange(len(shown)), shown]).round().clip(0, 255).astype(np.uint8)
    return PointCloud(directions * distance[:, None], color)


def _background(view: View, found: np.ndarray, side: int) -> View:
    """Reduce a photograph, and leave valid only the pixels that show none of the found points [P,3]."""
    small = reduced_view(view, min(1.0, side / max(view.camera.width, view.camera.height)))
    free = np.ones(small.image.shape[:2], bool) if small.valid_mask is None else small.valid_mask.copy()
    _, pixels, _ = small.camera.project_inside(found)
    columns, rows = pixels.astype(np.intp).T
    free[rows, columns] = False
    return replace(small, valid_mask=free)


def _directions(count: int) -> np.ndarray:
    """Return `count` unit vectors [count,3], spread evenly (a Fibonacci lattice)."""
    index = np.arange(count) + 0.5
    z, turn = 1 - 2 * index / count, np.pi * (1 + 5**0.5) * index
    ring = np.sqrt(1 - z * z)
    return np.stack([ring * np.cos(turn), ring * np.sin(turn), z], axis=1)


def _agreement(reduced: Sequence[View], places: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compare the photographs' colours at points [D,3] of the scene, where their pixels are valid.

    Returns the colours' standard deviation [D] and mean [D,3], sRGB 0..1, and the number [D] of photographs.
    """
    count, total, squares = np.zeros(len(places)), np.zeros((len(places), 3)), np.zeros((len(places), 3))
    for view in reduced:
        index, pixels, _ = view.camera.project_inside(places)
        if view.valid_mask is not None:
            free = valid_at(view.valid_mask, pixels)
            index, pixels = index[free], pixels[free]
        columns, rows = pixels.astype(np.intp).T
        color = view.image[rows, columns] / 255.0
        count[index] += 1
        total[index] += color
        squares[index] += color * color
    several = np.maximum(count, 2)[:, None]
    mean = total / np.maximum(count, 1)[:, None]
    variance = (squares - several * mean * mean).clip(0) / (several - 1)
    return np.sqrt(variance.sum(axis=1)), mean, count


def _smooth_levels(
    deviation: np.ndarray, neighbours: np.ndarray, options: BackgroundPointOptions
) -> tuple[np.ndarray, np.ndarray]:
    """Choose a distance level for each of D directions, with low deviation and close to its neighbours' levels.

    deviation [D,L]: sRGB 0..1, for each of L levels. neighbours [D,k]: the indices of neighbouring directions.
    Returns the levels [D], and smooth levels [D] that average each with its neighbours' mean.
    """
    cost = (deviation + deviation[neighbours].mean(axis=1)) / (2 * options.noise)
    levels = np.arange(cost.shape[1])
    level = cost.argmin(axis=1)
    for _ in range(options.rounds):
        beside = level[neighbours].mean(axis=1)
        level = (cost + np.square((levels - beside[:, None]) / options.step)).argmin(axis=1)
    return level, (level + level[neighbours].mean(axis=1)) / 2
