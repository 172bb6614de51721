"""Correction of exposures: all photographs are brought to a common exposure.

A camera that sets its own exposure or white balance shows the same surface brighter in one photograph than in the next.
`mgsr.training.exposure` finds the gain of each photograph's channels in linear light, relative to the
common exposure. This module divides by the gains, so all later steps see one exposure.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mgsr.config.expert import BrightnessOptions, ObservationOptions
from mgsr.data.images import linear_to_srgb, srgb_to_linear, to_uint8
from mgsr.data.pixels import PixelStore
from mgsr.data.robust import robust_deviation
from mgsr.data.scene import Exposures, Scene, View


def with_exposures(scene: Scene, exposures: Exposures) -> Scene:
    """Return the scene with its photographs at the common exposure.

    Like images that are read, the new images lie in files beyond the limit of `PixelStore`.
    """
    pixels = PixelStore()

    def at_common(view: View, factor: np.ndarray) -> View:
        """Return the view at the common exposure, by its factor [3], with the image in the store."""
        there = at_common_exposure(view, factor)
        return there if there.image is view.image else replace(there, image=pixels.hold(there.image))

    train = [at_common(view, factor) for view, factor in zip(scene.train, exposures.train, strict=True)]
    test = [at_common(view, factor) for view, factor in zip(scene.test, exposures.test, strict=True)]
    return replace(scene, train=train, test=test, exposures=exposures)


def at_common_exposure(view: View, factor: np.ndarray) -> View:
    """Return the view with its linear light divided by the factor [3].

    Values that become brighter than white are clipped. `View.white` tells the values that are clipped here or in the
    photograph.
    """
    light = srgb_to_linear(np.arange(256) / 255)[:, None] / factor
    table = to_uint8(255 * linear_to_srgb(np.clip(light, 0, 1)))
    clipped = math.ceil(255 * ObservationOptions().clipped)
    white = np.minimum(table[clipped], clipped).astype(np.uint8)
    if (factor == 1).all():
        return replace(view, white=white)
    image = np.stack([table[view.image[..., channel], channel] for channel in range(3)], axis=-1)
    return replace(view, image=image, white=white)


def raised_where_clipped(view: View, rendered: np.ndarray) -> np.ndarray:
    """Return a view's photograph [H,W,3], 0..1, for a comparison with a rendering [H,W,3].

    Where the photograph is clipped and the rendering brighter, the result has the rendering's values, because the
    photograph tells only how bright the light was at least.
    """
    image, clipped = view.image / 255, view.clipped
    return image if clipped is None else np.where(clipped, np.maximum(image, rendered), image)


def brightness_jumps(views: Sequence[View], options: BrightnessOptions = BrightnessOptions()) -> float:
    """Return the robust standard deviation of a photograph's log mean light from that of its neighbours.

    The scene's own light changes little from one camera to the next, so larger jumps come from exposure. A result of
    0.1 is a tenth more or less light.
    """
    return robust_jump(brightness_offsets(views, options), options)


def brightness_offsets(views: Sequence[View], options: BrightnessOptions = BrightnessOptions()) -> np.ndarray:
    """Return each photograph's log mean light [V] relative to that of its neighbours."""
    light = np.log(np.maximum([_mean_light(view, options.side) for view in views], 1e-6))
    centers = np.array([view.camera.center for view in views])
    directions = centers / np.maximum(np.linalg.norm(centers, axis=1, keepdims=True), 1e-9)
    alike = directions @ directions.T
    np.fill_diagonal(alike, -2)
    nearest = np.argsort(-alike, axis=1, kind="stable")[:, : options.neighbours]
    return np.asarray(light - light[nearest].mean(axis=1))


def robust_jump(offsets: np.ndarray, options: BrightnessOptions = BrightnessOptions()) -> float:
    """Return the robust standard deviation of a photograph's log light, from the result [V] of `brightness_offsets`."""
    # Convert the median difference between one value and the mean of equally varying neighbours to a standard
    # deviation.
    usual = robust_deviation(offsets - np.median(offsets))
    return usual / float(np.sqrt(1 + 1 / min(options.neighbours, len(offsets))))


def _mean_light(view: View, side: int) -> float:
    """Return the mean linear light over the object, or over the whole photograph without a mask.

    It is 0 where nothing is valid. side: pixels a side above which the photograph is subsampled.
    """
    step = max(1, max(view.image.shape[:2]) // side)
    some = (slice(None, None, step),) * 2
    light = srgb_to_linear(np.arange(256) / 255)[view.image[some]].mean(axis=-1)
    weight = np.ones(light.shape) if view.alpha is None else view.alpha[some].astype(np.float64)
    if view.valid_mask is not None:
        weight = weight * view.valid_mask[some]
    return float((light * weight).sum() / max(weight.sum(), 1e-6))
