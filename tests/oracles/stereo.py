"""The correlation of patches across views on given planes, in NumPy and float64, by exact homographies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mgsr.data.camera import Camera

GRAZING = 0.15  # least cosine between a plane's normal and the ray
STRETCH = (0.1, 10.0)  # of a pixel's area in a neighbour
# What a rule must be decided by to be clear: shares of the limit, of the cover and of all else; pixels to the border.
COVER, ROUNDING, BORDER = 0.03, 1e-4, 0.3


@dataclass(frozen=True)
class Judged:
    """The scores of planes.

    scores [P]; seen [P]: neighbours that show the patch; clear [P] bool: each rule that leaves out a neighbour or a
    plane is decided by more than rounding, or a patch that is bent a little, could change.
    """

    scores: np.ndarray
    seen: np.ndarray
    clear: np.ndarray


def judge(
    images: Sequence[np.ndarray],
    cameras: Sequence[Camera],
    places: np.ndarray,
    depths: np.ndarray,
    normals: np.ndarray,
    span: tuple[float, float],
    settings: Mapping[str, float],
) -> Judged:
    """Score planes that the first of the views sees through its pixels at places [P,2] (column, row), by the others.

    images: [h,w,4] float64, sRGB and the share of the object; depths [P] camera z; normals [P,3], unit, of the camera's
    frame; span: the least and the largest depth that count; settings: radius, spacing, noise, alike, reach, best, cover
    as `StereoSettings` has them.
    """
    rays = np.concatenate([places + 0.5, np.ones((len(places), 1))], axis=1) @ np.linalg.inv(cameras[0].K).T
    facing = (normals * rays).sum(axis=1)
    planes = normals / (depths * facing)[:, None]
    patch = np.arange(-settings["radius"], settings["radius"] + 1) * settings["spacing"]
    pixels = places[:, None] + 0.5 + np.stack(np.meshgrid(patch, patch), axis=-1).reshape(-1, 2)
    own, weights = weighed(images[0], places, pixels, settings)
    each = [
        correlate(image, homographies(cameras[0], camera, planes), places + 0.5, pixels, own, weights, settings)
        for image, camera in zip(images[1:], cameras[1:], strict=True)
    ]
    seen = np.sum([one.seen for one in each], axis=0)
    scores = mean_of_best(np.array([one.scores for one in each]), seen, int(settings["best"]))
    cosines = np.abs(facing) / np.linalg.norm(rays, axis=1)
    possible = (cosines >= GRAZING) & (depths >= span[0]) & (depths <= span[1])
    clear = decided(ROUNDING, cosines / GRAZING, depths / span[0], depths / span[1])
    return Judged(np.where(possible, scores, -1), seen, clear & np.all([one.clear for one in each], axis=0))


def mean_of_best(scores: np.ndarray, seen: np.ndarray, best: int) -> np.ndarray:
    """Return the mean [P] of the best of the neighbours' scores [N,P].

    The mean is of no more than show the patch (`seen` [P], which beat those that don't); -1 where fewer than two do, or
    than `best` if that is one.
    """
    counts = np.minimum(seen, best)
    descending = np.sort(scores, axis=0)[::-1]
    taken = np.arange(len(scores))[:, None] < counts
    means = np.where(taken, descending, 0).sum(axis=0) / np.maximum(counts, 1)
    return np.where(counts >= min(2, best), means, -1)


def weighed(
    image: np.ndarray, places: np.ndarray, pixels: np.ndarray, settings: Mapping[str, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Return samples [P,S,4] of the patches and their bilateral weights [P,S], 0 beyond the image."""
    samples, inside = bilinear(image, pixels)
    middles = image[places[:, 1], places[:, 0]]
    colors = ((samples - middles[:, None])[..., :3] ** 2).sum(axis=-1)
    away = ((pixels - places[:, None] - 0.5) ** 2).sum(axis=-1)
    weights = np.exp(-colors / (2 * settings["alike"] ** 2) - away / (2 * settings["reach"] ** 2))
    return samples, np.where(inside, weights * samples[..., 3], 0)


def homographies(first: Camera, other: Camera, planes: np.ndarray) -> np.ndarray:
    """Return the maps [P,3,3] from one camera's pixels to another's over planes [P,3], on which 1 / z = plane . ray."""
    pose = other.cam_from_world @ np.linalg.inv(first.cam_from_world)
    turned = pose[:3, :3] + pose[:3, 3, None] * planes[:, None]
    return np.asarray(other.K @ turned @ np.linalg.inv(first.K))


def carried(maps: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Map pixels [P,S,2] by homographies [P,3,3]."""
    there = np.concatenate([pixels, np.ones_like(pixels[..., :1])], axis=-1) @ maps.transpose(0, 2, 1)
    return np.asarray(there[..., :2] / there[..., 2:])


def correlate(
    image: np.ndarray,
    maps: np.ndarray,
    middles: np.ndarray,
    pixels: np.ndarray,
    own: np.ndarray,
    weights: np.ndarray,
    settings: Mapping[str, float],
) -> Judged:
    """Correlate samples [P,S,4] at pixels [P,S,2] around middles [P,2] with what one neighbour shows of the planes."""
    its = bilinear(image, carried(maps, pixels))[0]
    both = weights * its[..., 3]
    covered = both.sum(axis=1) / np.maximum(weights.sum(axis=1), 1e-12)
    share = (both / np.maximum(both.sum(axis=1, keepdims=True), 1e-12))[..., None]
    here, there = (colors[..., :3] - (share * colors[..., :3]).sum(axis=1, keepdims=True) for colors in (own, its))
    noise = 3 * settings["noise"] ** 2
    variances = [(share * colors**2).sum(axis=(1, 2)) + noise for colors in (here, there)]
    scores = (share * here * there).sum(axis=(1, 2)) / np.sqrt(variances[0] * variances[1])

    step = 1e-3
    near = carried(maps, middles[:, None] + step * np.array([[0, 0], [1, 0], [0, 1]]))
    jacobian = (near[:, 1:] - near[:, :1]) / step
    stretch = np.linalg.det(jacobian)
    half = settings["radius"] * settings["spacing"] * np.abs(jacobian).sum(axis=1)
    size = np.array([image.shape[1], image.shape[0]])
    room = np.minimum(near[:, 0] - half - 0.5, size - 0.5 - near[:, 0] - half).min(axis=1)
    shown = (room >= 0) & (stretch > STRETCH[0]) & (stretch < STRETCH[1]) & (covered >= settings["cover"])
    clear = decided(COVER, covered / settings["cover"]) & decided(ROUNDING, *(stretch / limit for limit in STRETCH))
    return Judged(np.where(shown, scores, -1), shown, clear & (np.abs(room) > BORDER))


def decided(slack: float, *shares: np.ndarray) -> np.ndarray:
    """Return where [P] none of the shares [P] of a limit is within `slack` of 1."""
    return np.asarray(np.all([np.abs(share - 1) > slack for share in shares], axis=0))


def bilinear(image: np.ndarray, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the image's bilinear values [...,4] at pixel coordinates [...,2], and which lie between centres [...].

    Centres are at +0.5.
    """
    height, width = image.shape[:2]
    places = pixels - 0.5
    inside = np.asarray(((places >= 0) & (places < (width - 1, height - 1))).all(axis=-1))
    places = np.where(inside[..., None], places, 0)
    corners = np.floor(places).astype(int)
    (column, row), (across, down) = np.moveaxis(corners, -1, 0), np.moveaxis(places - corners, -1, 0)[..., None]
    upper = (1 - across) * image[row, column] + across * image[row, column + 1]
    lower = (1 - across) * image[row + 1, column] + across * image[row + 1, column + 1]
    return (1 - down) * upper + down * lower, inside
