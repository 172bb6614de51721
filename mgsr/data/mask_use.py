"""The meaning of the masks beside photographs: silhouettes of the object, or regions to ignore.

In COLMAP, nerfstudio and other programs, masks are black on passers-by, a tripod or a strip of the image, and white
elsewhere. There, black means unknown, and not off the object.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum

import numpy as np

from mgsr.config.expert import MaskUseOptions
from mgsr.data.camera import Camera
from mgsr.data.masks import inverted_masks, leave_borders_free, white_borders
from mgsr.data.normalise import unmasked_ball
from mgsr.errors import SceneError

_CHOICE = (
    "choose masks=object (white is the object to reconstruct), masks=ignore (black is left out, such as passers-by or "
    "a tripod) or masks=off (masks are not used)"
)


class MaskUse(StrEnum):
    """The meaning of masks.

    object: white is the object, and the rest is background. ignore: black is unknown, and the rest is used.
    """

    OBJECT = "object"
    IGNORE = "ignore"


def find_mask_use(
    masks: Sequence[np.ndarray], cameras: Sequence[Camera], options: MaskUseOptions = MaskUseOptions()
) -> MaskUse:
    """Return the meaning of masks [H,W] uint8, one for each camera.

    If the masks are black on the images' borders, they are silhouettes of an object. Otherwise the black parts decide.
    If they agree on one place in space, around the object, the masks are silhouettes. If they lie somewhere else in
    each view, they mark regions to ignore.

    Raises SceneError, with the two meanings, if neither is clear, and for inverted silhouettes.
    """
    if leave_borders_free(masks, options):
        return MaskUse.OBJECT
    black = np.array([(mask < 128).mean() for mask in masks])
    if np.median(black) < options.min_black and black.mean() < 2 * options.min_black:
        return MaskUse.IGNORE
    agreement, borders = _agreement_in_space(masks, cameras, options), white_borders(masks)
    same_pixels = borders >= options.strip_border and _agreement_in_image(masks, options) > options.same_pixels
    if agreement < options.ignored or (same_pixels and _black_corners(masks) <= 2):
        return MaskUse.IGNORE
    if agreement > options.inverted and inverted_masks(masks, options):
        raise SceneError(
            "the masks are inverted, white around the object and black on it; make them white on the object, or "
            + _CHOICE
        )
    if agreement > options.silhouettes and borders < options.white_border and not same_pixels:
        return MaskUse.OBJECT
    raise doubt(masks)


def doubt(masks: Sequence[np.ndarray]) -> SceneError:
    """Return the error that explains the two meanings of masks [H,W]."""
    white = float(np.mean([(mask >= 128).mean() for mask in masks]))
    return SceneError(f"the masks may mark an object or areas to ignore ({white:.0%} white); {_CHOICE}")


def require_plausible_ball(
    radius: float,
    masks: Sequence[np.ndarray],
    cameras: Sequence[Camera],
    options: MaskUseOptions = MaskUseOptions(),
) -> None:
    """Raise SceneError (`doubt`) where the object's ball would be many times larger than the images' field of view.

    masks [H,W] uint8. Masks that only leave out the sky or the corners show no object.
    """
    if radius > options.max_ball * unmasked_ball(cameras, None)[1]:
        raise doubt(masks)


def _agreement_in_space(masks: Sequence[np.ndarray], cameras: Sequence[Camera], options: MaskUseOptions) -> float:
    """Return how well the masks [H,W] agree on the black places of a grid around the cameras' focus."""
    center, radius = unmasked_ball(cameras, None)
    axis = np.linspace(-1, 1, options.places)
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    points = center + options.reach * radius * grid
    pairs = (_seen(points, mask, camera) for mask, camera in zip(masks, cameras, strict=True))
    seen, black = (np.array(part) for part in zip(*pairs, strict=True))
    return _agreement(seen, black)


def _agreement_in_image(masks: Sequence[np.ndarray], options: MaskUseOptions) -> float:
    """Return how well the masks [H,W] agree on the black parts of the image."""
    axis = (np.arange(options.places) + 0.5) / options.places
    rows = [mask[(axis * len(mask)).astype(int)][:, (axis * mask.shape[1]).astype(int)].ravel() for mask in masks]
    black = np.array(rows) < 128
    return _agreement(np.ones_like(black), black)


def _black_corners(masks: Sequence[np.ndarray]) -> float:
    """Return the median number of black corners of a mask."""
    return float(np.median([(mask[[0, 0, -1, -1], [0, -1, 0, -1]] < 128).sum() for mask in masks]))


def _agreement(seen: np.ndarray, black: np.ndarray) -> float:
    """Return by how much black in one view makes black in another view more likely than average.

    The result is the share of other views that agree, minus the share of all visible places that are black. seen, black
    [V,P] bool: which places each view sees, and which of these are black.
    """
    views, votes = seen.sum(axis=0), black.sum(axis=0)
    pairs = (votes * (views - 1)).sum()
    if pairs == 0:
        return 0.0
    return float((votes * (votes - 1)).sum() / pairs - votes.sum() / views.sum())


def _seen(points: np.ndarray, mask: np.ndarray, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Return which points [P,3] a view sees, and which of them its mask has black, both [P] bool."""
    pixels, depth = camera.project(points)
    inside = (depth > 0) & (pixels >= 0).all(axis=1) & (pixels < [camera.width, camera.height]).all(axis=1)
    columns, rows = np.where(inside[:, None], pixels, 0).astype(np.intp).T
    return inside, inside & (mask[rows, columns] < 128)
