"""Find photographs that are much less sharp than their neighbours, because of motion blur or missed focus."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import compress

import numpy as np
from scipy.linalg import eigh

from mgsr.config import Flawed
from mgsr.config.expert import SharpnessOptions
from mgsr.data.loading import LoadedView
from mgsr.data.scene import View
from mgsr.parallel import map_ahead

_NAMED = 3  # the most photographs that a note names


def without_blurred(
    train: list[LoadedView],
    test: list[LoadedView],
    blurred: Flawed,
    options: SharpnessOptions = SharpnessOptions(),
) -> tuple[tuple[list[LoadedView], list[LoadedView]], tuple[str, ...]]:
    """Return the training and test views, and a note on views that are much less sharp than their neighbours.

    `Flawed.DROP` removes these views.
    """
    views = [item.view for item in (*train, *test)]
    less = less_sharp(views, options)
    if not less.any():
        return (train, test), ()
    names = sorted(view.name for view in compress(views, less))
    shown = ", ".join(names[:_NAMED]) + (", ..." if len(names) > _NAMED else "")
    text = f"{len(names)} of {len(views)} photographs are much less sharp than their neighbours ({shown})"
    if blurred is Flawed.KEEP:
        cure = f"skip them with `--set flawed=drop` if the other {len(views) - len(names)} show the whole object"
        return (train, test), (f"{text}, which costs accuracy; take them again, or {cure}",)
    kept = list(compress(train, ~less[: len(train)])), list(compress(test, ~less[len(train) :]))
    return kept, (f"{text}; they are skipped",)


def less_sharp(views: Sequence[View], options: SharpnessOptions = SharpnessOptions()) -> np.ndarray:
    """Return which views are much less sharp than their neighbours, [V] bool."""
    return lost_sharpness(views, options) > options.max_loss


def lost_sharpness(views: Sequence[View], options: SharpnessOptions = SharpnessOptions()) -> np.ndarray:
    """Return how much less sharp each view is than its neighbours, [V], in powers of two.

    The result is 0 for fewer than three views, and for thumbnails.
    """
    if len(views) < 3 or min(min(view.image.shape[:2]) for view in views) < options.min_side:
        return np.zeros(len(views))
    sharpness = np.array(list(map_ahead(lambda view: _sharpness(view, options), views, None)))
    neighbours = _neighbours(views, options)
    # The second sharpest, because a single neighbour may show a more detailed part of the scene.
    best = np.array([np.sort(sharpness[near])[-2] for near in neighbours])
    return np.asarray(best - sharpness)


def _sharpness(view: View, options: SharpnessOptions) -> float:
    """Return the logarithm to base 2 of a view's sharpness in its least sharp direction.

    Sharpness is the mean squared gradient, divided by that of the smoothed photograph. It does not depend on contrast,
    and only a little on content. The least sharp direction counts because motion blurs only one direction.
    """
    import cv2  # imported here, because training needs no OpenCV

    grey: np.ndarray = cv2.cvtColor(view.image, cv2.COLOR_RGB2GRAY).astype(np.float32)
    if view.alpha is not None:  # composite on white
        grey = 255 + (grey - 255) * (view.alpha * np.float32(1 / 255))
    shrink = options.side / max(grey.shape)
    if shrink < 1:
        grey = cv2.resize(grey, None, fx=shrink, fy=shrink, interpolation=cv2.INTER_AREA)
    fine, coarse = _gradients(grey), _gradients(cv2.GaussianBlur(grey, (0, 0), options.sigma))
    return float(np.log2(eigh(fine, coarse, eigvals_only=True)[0]))


def _gradients(grey: np.ndarray) -> np.ndarray:
    """Return the mean outer product [2,2] of the gradients of an image [H,W].

    A small multiple of the identity is added, so that the matrix can be inverted.
    """
    down, right = np.gradient(grey)
    cross = (right * down).mean()
    return np.array([[(right * right).mean(), cross], [cross, (down * down).mean()]]) + 0.02 * np.eye(2)


def _neighbours(views: Sequence[View], options: SharpnessOptions) -> list[np.ndarray]:
    """Return, for each view, the indices [K] int64 of the views that show nearly the same part of the scene."""
    centers = np.array([view.camera.center for view in views])
    axes = np.array([view.camera.cam_from_world[2, :3] for view in views])
    spread = np.linalg.norm(centers - centers.mean(axis=0), axis=1).mean() or 1.0
    order = np.argsort([view.name for view in views], kind="stable")
    place = np.argsort(order)
    found = []
    for i in range(len(views)):
        apart = np.linalg.norm(centers - centers[i], axis=1) / spread + np.linalg.norm(axes - axes[i], axis=1)
        nearest = np.argsort(apart)[: options.nearest + 1]
        beside = order[max(place[i] - options.adjacent, 0) : place[i] + options.adjacent + 1]
        beside = beside[axes[beside] @ axes[i] > np.cos(np.radians(options.same_side))]
        found.append(np.setdiff1d(np.union1d(nearest, beside), [i]))
    return found
