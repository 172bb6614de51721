"""Exposure differences between photographs.

In photographs of a whole room, most surfaces look the same from all sides. There, the starting points tell whether
exposures differ, and by what factors (see `point_exposures`). Around an object with masks, a small 3D branch is trained
to tell both. Where the object is matte, the points give the more exact factors there too.

The branch can't reproduce the exposure factor of a held-out view. A factor is therefore fitted to one half of each
held-out view and tested on the other half: if it improves that half too, exposures differ. The branch explains a flash
or gloss by direction, and the remaining error is rarely the same in both halves.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch

from mgsr.config import Background, ExpertConfig
from mgsr.config.expert import ExposureOptions
from mgsr.data.exposure import at_common_exposure, brightness_jumps
from mgsr.data.images import linear_to_srgb, srgb_to_linear
from mgsr.data.robust import robust_deviation
from mgsr.data.scene import Exposures, Scene, View, some_of
from mgsr.gaussians.trained_model import TrainedModel
from mgsr.parallel import one_torch_thread
from mgsr.start.point_exposures import exposure_gain, point_exposures
from mgsr.start.points import StartingPoints
from mgsr.training.evaluate import gaussian_picture
from mgsr.training.proxy_model import ProxyTraining, small_view, train_proxy_model

DIGITS = 5  # decimal digits to which factors are rounded
REWEIGHTINGS, HUBER = 8, 1.5  # of the fit of a factor: rounds, and deviations above which errors weigh less


def find_exposures(
    scene: Scene,
    start: StartingPoints,
    seed: int,
    should_stop: Callable[[], bool] = lambda: False,
    expert: ExpertConfig = ExpertConfig(),
) -> Exposures | None:
    """Estimate each photograph's exposure, with a geometric mean of 1 over the training views.

    Returns None where exposures are equal, or can't be separated from lighting effects. The same seed gives the same
    factors, on any number of cores. expert: the options of all algorithms.

    Raises Cancelled once should_stop returns True, and TrainingError if training fails.
    """
    options = expert.training.exposure
    if len(scene.train) < options.min_views:
        return None
    if brightness_jumps(some_of(scene.train, options.jump_views), scene.options.brightness) < options.min_jump:
        return None
    degrees, small = (0, options.degree), [small_view(view, options.proxy.side) for view in scene.train]
    tests = [small_view(view, options.proxy.side) for view in scene.test]
    if not scene.masked and start.surface is None:
        gain = exposure_gain(small, start.positions, start.normals, expert.start.exposures)
        if gain is not None and gain < options.min_gain:
            return None
        point_factors = point_exposures(small, tests, start.positions, start.normals, expert.start.exposures)
        if gain is not None and point_factors is not None:
            return _rounded(point_factors, len(small))
    trainings = {
        degree: ProxyTraining("exposures", degree, options.iterations, seed, options.proxy) for degree in degrees
    }
    with one_torch_thread():
        errors = {
            degree: _kept_errors(scene, start, small, training, should_stop, options)
            for degree, training in trainings.items()
        }
        degree = min(degrees, key=lambda each: float(errors[each][1]))
        if errors[degree][0] - errors[degree][1] < options.min_gain:
            return None
        if degree == 0 or not scene.masked:
            point_factors = point_exposures(small, tests, start.positions, start.normals, expert.start.exposures)
            if point_factors is not None:
                return _rounded(point_factors, len(small))
        factors = np.ones((len(small), 3))
        for _ in range(options.rounds):
            corrected = [at_common_exposure(view, factor) for view, factor in zip(small, factors, strict=True)]
            picture = _trained(scene, start, corrected, trainings[degree], should_stop)
            factors = np.stack([_factor(view, picture(view), options) for view in small])
            mean = np.exp(np.log(factors).mean(axis=0))
            factors /= mean
        of_tests = [_factor(view, picture(view), options) / mean for view in tests]
    return _rounded(np.concatenate([factors, np.reshape(of_tests, (-1, 3))]), len(small))


def _rounded(factors: np.ndarray, train: int) -> Exposures:
    """Round the factors [V,3], of the training views first, as exposures.json does.

    So later steps see the same photographs whether they read the file or not.
    """
    return Exposures(factors[:train].round(DIGITS), factors[train:].round(DIGITS))


def _kept_errors(
    scene: Scene,
    start: StartingPoints,
    small: list[View],
    training: ProxyTraining,
    should_stop: Callable[[], bool],
    options: ExposureOptions,
) -> np.ndarray:
    """Return the mean `_errors` [2] of held-out views.

    One view in `held_out` is held out, then others in the same way, until at least `min_views` views were held out: a
    mean over fewer is unreliable.
    """
    errors: list[tuple[float, float]] = []
    for first in (*range(1, options.held_out), 0):
        kept = small[first :: options.held_out]
        seen = [view for index, view in enumerate(small) if index % options.held_out != first]
        picture = _trained(scene, start, seen, training, should_stop)
        errors += [_errors(view, picture(view), options) for view in kept]
        if len(errors) >= options.min_views:
            break
    return np.asarray(np.mean(errors, axis=0))


def _trained(
    scene: Scene,
    start: StartingPoints,
    views: list[View],
    training: ProxyTraining,
    should_stop: Callable[[], bool],
) -> Callable[[View], np.ndarray]:
    """Train Gaussians on some views, and return a function that renders a view's linear light [H,W,3]."""
    model = train_proxy_model(scene, start, views, training, should_stop)
    picture, behind = gaussian_picture(TrainedModel(None, model)), scene.backdrop(Background.AUTO)

    @torch.no_grad()
    def light(view: View) -> np.ndarray:
        """Return the linear light [H,W,3] of a view's render."""
        return srgb_to_linear(picture(view.camera, behind.color, None).clamp(0, 1).numpy().astype(np.float64))

    return light


def _errors(view: View, rendered: np.ndarray, options: ExposureOptions) -> tuple[float, float]:
    """Return the errors of a view's rendering [H,W,3], in dB, as it is and after a gain.

    The gain of each half of the view's pixels is fitted to the other half.
    """
    usable = _usable(view, options)
    columns = np.broadcast_to(np.arange(usable.shape[1]), usable.shape)
    if not usable.any():
        return 0.0, 0.0
    left = columns < np.median(columns[usable])
    before, after = 0.0, 0.0
    for half in (left, ~left):
        target = view.image[usable & half] / 255.0
        factor = _fitted(view, rendered, usable & ~half, options)
        if not len(target) or factor is None:
            return 0.0, 0.0
        there = rendered[usable & half]
        before += float(np.square(target - linear_to_srgb(there)).mean())
        after += float(np.square(target - linear_to_srgb(np.clip(there * factor, 0, 1))).mean())
    return 10 * float(np.log10(max(before, 1e-9))), 10 * float(np.log10(max(after, 1e-9)))


def _factor(view: View, rendered: np.ndarray, options: ExposureOptions) -> np.ndarray:
    """Return the factor [3] between a view's light and its rendering's [H,W,3]; 1 if too few pixels are usable."""
    fitted = _fitted(view, rendered, _usable(view, options), options)
    return np.ones(3) if fitted is None else fitted


def _usable(view: View, options: ExposureOptions) -> np.ndarray:
    """Return a mask [H,W] bool of the pixels that are valid, lie inside the object, and are not clipped."""
    usable = (view.image < options.clipped).all(axis=-1)
    if view.alpha is not None:
        usable &= view.alpha >= options.clipped
    return np.asarray(usable if view.valid_mask is None else usable & view.valid_mask)


def _fitted(view: View, rendered: np.ndarray, usable: np.ndarray, options: ExposureOptions) -> np.ndarray | None:
    """Fit the factor [3] by which the photograph's linear light exceeds the rendering's [H,W,3] at usable pixels.

    usable [H,W] bool. The fit minimises relative errors, by iteratively reweighted least squares. Its Huber weights
    reduce errors above HUBER deviations. Returns None if too few pixels are usable.
    """
    factor = np.ones(3)
    for channel in range(3):
        target = srgb_to_linear(view.image[..., channel][usable] / 255.0)
        there = rendered[..., channel][usable]
        bright = there > options.faint * np.median(there) if len(there) else np.zeros(0, bool)
        if bright.sum() < options.min_pixels:
            return None
        target, there = target[bright], there[bright]
        found = float(np.median(target) / np.median(there))
        for _ in range(REWEIGHTINGS):
            if found <= 0:
                return None
            error = target / (found * there) - 1
            spread = max(robust_deviation(error), 1e-3)
            weight = np.minimum(1, HUBER * spread / np.maximum(np.abs(error), 1e-9)) * (found * there < options.white)
            if not weight.any():
                return None
            found = float((weight * target / there).sum() / weight.sum())
        factor[channel] = found
    return factor
