"""Sharpening of a texture by iterative back-projection.

A texel's blended colour is blurred, because each view's pixels average the colours that they show, and the views are
sampled between pixels. Each round renders the texture into every view, and adds the mean difference between the view
and that render to the texels. Source: Irani and Peleg 1991.
"""

from __future__ import annotations

import cv2
import numpy as np

from mgsr.config.expert import ColorOptions
from mgsr.mesh.colors import PointsInViews, robust_weights
from mgsr.mesh.views import bilinear_cells, nearest, sample
from mgsr.parallel import map_ahead

AROUND = (3, 3)  # pixels over which texels are counted


def sharpened(
    colors: np.ndarray, points: PointsInViews, threads: int | None = None, options: ColorOptions = ColorOptions()
) -> np.ndarray:
    """Return the colours [P,3] float32 sRGB 0..1 whose renders come nearest to the views.

    colors [P,3]: the blended colours of surface points, one for each texel. points: these points in the views. A pixel
    counts if it and its neighbours hold at least `options.min_texels` texels each, on average. Textures that are
    coarser than the views therefore stay as they are.
    """
    for _ in range(options.back_projections):

        def difference(number: int, current: np.ndarray = colors) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            """Return the indices [Q] of the points that a view shows, their differences [Q,3] and weights [Q]."""
            view, shown = points.views[number], points.shown_by(number)
            own = current[shown.index]
            rendered, texels = _splatted(own, shown.pixels, view.depth.shape)
            known = nearest(cv2.blur(texels, AROUND), shown.pixels) >= options.min_texels
            off = sample(view.color, shown.pixels) - own
            weights = known * robust_weights(shown.weights, off, options.deviation)
            return shown.index, sample(np.where(texels[..., None] > 0, view.color - rendered, 0), shown.pixels), weights

        sums, total = np.zeros_like(colors), np.zeros(len(colors), np.float32)
        for index, differences, weights in map_ahead(difference, range(len(points.views)), threads):
            sums[index] += differences * weights[:, None]
            total[index] += weights
        colors = np.clip(colors + sums / (total + options.prior_weight)[:, None], 0, 1)
    return colors


def _splatted(colors: np.ndarray, pixels: np.ndarray, size: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Render points of colors [Q,3] at pixels [Q,2] (centres at +0.5) into an image of a size (height, width).

    Each point is shared bilinearly between four pixels. Returns the pixels' mean colours [H,W,3] float32, 0 without a
    point, and the sums of the shares [H,W], which are numbers of texels.
    """
    height, width = size
    left, top, fx, fy = bilinear_cells(pixels, size)
    place = np.concatenate([(top + down) * width + left + right for down in (0, 1) for right in (0, 1)])
    share = np.concatenate([(1 - fy) * (1 - fx), (1 - fy) * fx, fy * (1 - fx), fy * fx])
    total = np.bincount(place, share, height * width)
    sums = [np.bincount(place, share * np.tile(channel, 4), height * width) for channel in colors.T]
    means = np.stack(sums, axis=1) / np.maximum(total, 1e-12)[:, None]
    return means.reshape(height, width, 3).astype(np.float32), total.reshape(height, width)
