"""The check for photographs that are brighter or darker than others of the same places."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mgsr.config.expert import BrightnessOptions, InspectionConfig
from mgsr.data.exposure import brightness_offsets, robust_jump
from mgsr.data.robust import robust_deviation
from mgsr.data.scene import View
from mgsr.inspection.features import Features
from mgsr.inspection.findings import Code, Finding, Severity, pick
from mgsr.inspection.pairs import Pair


def check_exposures(
    views: Sequence[View],
    names: Sequence[str],
    features: Sequence[Features],
    pairs: Sequence[Pair],
    options: InspectionConfig = InspectionConfig(),
    brightness: BrightnessOptions = BrightnessOptions(),
) -> list[Finding]:
    """Return a finding if photographs are brighter or darker than others that show the same places.

    An exposure changes all of a photograph. Light and gloss of the scene change parts of it, so only the change that
    both halves of a photograph share counts. A photograph without enough matches counts if it has at least twice or at
    most half the light of its neighbours. features, pairs: of the views.
    """
    limits = options.photos
    if len(views) < 6:
        return []
    halves = light_of_halves(features, pairs, options)
    known = np.isfinite(halves).all(axis=1)
    spread = (
        _common_spread(halves[known], limits.common) if known.sum() >= max(6, limits.min_known * len(views)) else 0.0
    )
    by_mean = brightness_offsets(views, brightness)
    offsets = np.where(known, _shared_part(halves), by_mean - np.median(by_mean))
    usual = np.where(known, spread, robust_jump(by_mean, brightness))
    odd = np.flatnonzero(np.abs(offsets) > np.maximum(np.log(limits.outlier), 5 * usual))
    if spread < limits.jumps and not len(odd):
        return []
    largest = float(np.abs(offsets[known | np.isin(np.arange(len(views)), odd)]).max())
    return [
        Finding(
            Code.EXPOSURE_JUMPS,
            Severity.WARNING if len(odd) else Severity.NOTE,
            f"the light changes by {np.expm1(spread):.0%} from one photograph to its neighbours"
            + (f", and by twice or more in {len(odd)}" if len(odd) else ""),
            round(float(np.exp(largest)), 2),
            "times",
            "fix exposure and white balance of the camera; MGSR corrects what remains, except for clipped light",
            pick(names, odd),
        )
    ]


def light_of_halves(
    features: Sequence[Features], pairs: Sequence[Pair], options: InspectionConfig = InspectionConfig()
) -> np.ndarray:
    """Return the log light [V,2] of both halves of each photograph, relative to its pairs; NaN if it is unknown.

    It is the median over the matches that lie on the epipolar lines of the cameras.
    """
    photos, pixels, differences = [], [], []
    for pair in pairs:
        here, there = pair.matches[pair.residuals < options.pairs.inlier].T
        change = features[pair.other].light[there] - features[pair.one].light[here]
        for photo, places, sign in ((pair.one, here, -1), (pair.other, there, 1)):
            photos.append(np.full(len(places), photo))
            pixels.append(features[photo].pixels[places])
            differences.append(sign * change)
    halves = np.full((len(features), 2), np.nan)
    if not pairs:
        return halves
    of_photo, at, light = np.concatenate(photos), np.concatenate(pixels), np.concatenate(differences)
    known = np.isfinite(light)
    for index in range(len(features)):
        mine = known & (of_photo == index)
        if mine.sum() >= options.photos.shared_places:
            upper = _upper_half(at[mine])
            halves[index] = np.median(light[mine][upper]), np.median(light[mine][~upper])
    return halves


def _upper_half(places: np.ndarray) -> np.ndarray:
    """Return which of the places [N,2] lie in the upper half along the direction of their largest spread, [N] bool."""
    apart = places - np.median(places, axis=0)
    along = apart @ np.linalg.svd(apart, full_matrices=False)[2][0]
    upper = np.zeros(len(along), bool)
    upper[np.argsort(along, kind="stable")[len(along) // 2 :]] = True
    return upper


def _common_spread(halves: np.ndarray, least: float) -> float:
    """Return the robust standard deviation that both halves [V,2] share; 0 if their correlation is below `least`.

    Source of the covariance: Gnanadesikan and Kettenring 1972.
    """
    common, apart = _squared_deviation(halves.mean(axis=1)), _squared_deviation((halves[:, 0] - halves[:, 1]) / 2)
    return float(np.sqrt(common - apart)) if common - apart > least * (common + apart) else 0.0


def _squared_deviation(values: np.ndarray) -> float:
    """Return the square of the robust standard deviation of values [V], from their median absolute deviation."""
    return robust_deviation(values - np.median(values)) ** 2


def _shared_part(halves: np.ndarray) -> np.ndarray:
    """Return the part [V] that both halves [V,2] share: the smaller one, or 0 if their signs differ."""
    smaller = np.abs(halves).min(axis=1)
    return np.asarray(np.where(halves.prod(axis=1) > 0, np.sign(halves[:, 0]) * smaller, 0.0))
