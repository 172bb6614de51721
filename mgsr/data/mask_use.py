"""The meaning of the masks beside photographs: silhouettes of the object, or regions to ignore.

In COLMAP, nerfstudio and other programs, masks are black on passers-by, a tripod or a strip of the image, and white
elsewhere. There, black means unknown, and not off the object.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum

import numpy as np

from mgsr.data.camera import Camera
from mgsr.data.masks import inverted_masks, leave_borders_free, white_borders
from mgsr.data.normalise import unmasked_ball
from mgsr.errors import SceneError

# The black parts of masks are compared on a cube of points: their number along each side, and half the side over the
# radius of the ball that the images show whole. The images' corners show more than that ball.
_SIDE = 20
_REACH = 1.25

# The least median share of black pixels in silhouettes. Masks with less black give no information on the shape, as the
# object fills the image.
_NEXT_TO_NOTHING = 0.01

# Black regions lie at one place in space where this share of the other views agrees, in excess of chance. On the shared
# scenes, cut down to a half or a third of the image, the masks of objects have 0.09 to 0.23; black rectangles at random
# places have at most 0.04, and with 6 views 0.08.
_ELSEWHERE, _SAME_PLACE = 0.04, 0.06

# Inverted silhouettes agree better than this: 0.11 with 6 views, 0.15 to 0.19 on the shared scenes.
_INVERTED = 0.1

# The same for places in the image. With borders at least as white as this, masks that are black at the same pixels in
# all views hide a strip of the image or the camera's own stand; where they are black in the corners, they may also show
# a round object that the images cut off.
_SAME_PIXELS = 0.6
_STRIP_BORDERS = 0.6

# With borders as white as this and black at one place in space, masks show an object that fills nearly all images, or
# a thing that stands still and is to be ignored.
_WHITE_BORDERS = 0.85

# Radii of the ball that the images show whole. Objects twice as large as the images reach 1.8 beyond it; the skies and
# lens hoods that were tried make balls of 2.5 to 20.
_LARGEST_BALL = 2.4

_CHOICE = (
    "choose masks=object (white is the object to reconstruct), masks=ignore (black is left out, such as passers-by or "
    "a tripod) or masks=off (masks are not used)"
)


class MaskUse(StrEnum):
    """object: white is the object, all else is not. ignore: black is unknown, all else is used."""

    OBJECT = "object"
    IGNORE = "ignore"


def find_mask_use(masks: Sequence[np.ndarray], cameras: Sequence[Camera]) -> MaskUse:
    """Return what masks [H,W] uint8, one for each camera, mean.

    Masks that leave the images' borders black show an object before its surroundings. Other masks show one where their
    black parts lie at one place in space, around the object. Black parts that lie somewhere else in each view are to be
    ignored. Raises SceneError, with the two meanings, where neither is clear, and for inverted silhouettes.
    """
    if leave_borders_free(masks):
        return MaskUse.OBJECT
    black = np.array([(mask < 128).mean() for mask in masks])
    if np.median(black) < _NEXT_TO_NOTHING and black.mean() < 2 * _NEXT_TO_NOTHING:
        return MaskUse.IGNORE
    agreement, borders = _agreement_in_space(masks, cameras), white_borders(masks)
    same_pixels = borders >= _STRIP_BORDERS and _agreement_in_image(masks) > _SAME_PIXELS
    if agreement < _ELSEWHERE or (same_pixels and _black_corners(masks) <= 2):
        return MaskUse.IGNORE
    if agreement > _INVERTED and inverted_masks(masks):
        raise SceneError(
            "the masks are inverted, white around the object and black on it; make them white on the object, or "
            + _CHOICE
        )
    if agreement > _SAME_PLACE and borders < _WHITE_BORDERS and not same_pixels:
        return MaskUse.OBJECT
    raise doubt(masks)


def doubt(masks: Sequence[np.ndarray]) -> SceneError:
    """Return the error that explains the two meanings of masks [H,W]."""
    white = float(np.mean([(mask >= 128).mean() for mask in masks]))
    return SceneError(f"the masks may mark an object or areas to ignore ({white:.0%} white); {_CHOICE}")


def require_plausible_ball(radius: float, masks: Sequence[np.ndarray], cameras: Sequence[Camera]) -> None:
    """Raise SceneError (`doubt`) where the object's ball would be many times larger than the images' field of view.

    masks [H,W] uint8. Masks that only leave out the sky or the corners show no object.
    """
    if radius > _LARGEST_BALL * unmasked_ball(cameras, None)[1]:
        raise doubt(masks)


def _agreement_in_space(masks: Sequence[np.ndarray], cameras: Sequence[Camera]) -> float:
    """Return how well the masks [H,W] agree on the black places of a grid around the cameras' focus."""
    center, radius = unmasked_ball(cameras, None)
    axis = np.linspace(-1, 1, _SIDE)
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    points = center + _REACH * radius * grid
    pairs = (_seen(points, mask, camera) for mask, camera in zip(masks, cameras, strict=True))
    seen, black = (np.array(part) for part in zip(*pairs, strict=True))
    return _agreement(seen, black)


def _agreement_in_image(masks: Sequence[np.ndarray]) -> float:
    """Return how well the masks [H,W] agree on the black parts of the image."""
    axis = (np.arange(_SIDE) + 0.5) / _SIDE
    rows = [mask[(axis * len(mask)).astype(int)][:, (axis * mask.shape[1]).astype(int)].ravel() for mask in masks]
    black = np.array(rows) < 128
    return _agreement(np.ones_like(black), black)


def _black_corners(masks: Sequence[np.ndarray]) -> float:
    """Return the median number of black corners of a mask."""
    return float(np.median([(mask[[0, 0, -1, -1], [0, -1, 0, -1]] < 128).sum() for mask in masks]))


def _agreement(seen: np.ndarray, black: np.ndarray) -> float:
    """Return how much likelier than average a place is black in one view if it is black in another.

    seen, black: [V,P] bool; black only where seen. It is the share of other views that agree, less the share of all
    seen places that are black.
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
