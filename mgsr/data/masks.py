"""Bring masks to their photograph's size, detect inverted ones, and replace a scene's masks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mgsr.config.expert import MaskUseOptions
from mgsr.data.capture import Photo
from mgsr.data.images import reduce_area, to_uint8
from mgsr.data.scene import Scene
from mgsr.errors import SceneError

# A mask's sides may differ by this much in scale: programs that shrink masks round their sides.
_SHAPE_TOLERANCE = 0.01


def fitted_mask(mask: np.ndarray, width: int, height: int, photo: Photo) -> np.ndarray:
    """Return a mask of any size and the same shape as [height,width] uint8.

    Larger masks are reduced by area means; smaller ones are enlarged smoothly. Raises SceneError for other shapes.
    """
    if mask.shape == (height, width):
        return mask
    across, down = width / mask.shape[1], height / mask.shape[0]
    if abs(across / down - 1) > _SHAPE_TOLERANCE:
        raise SceneError(
            f"mask {photo.mask}: {mask.shape[1]}x{mask.shape[0]} pixels, but its image has {width}x{height}; make a "
            "mask of the image's size or aspect ratio"
        )
    if across < 1 and down < 1:
        return to_uint8(reduce_area(mask[..., None], width, height)[..., 0])
    import cv2  # imported here, because training needs no OpenCV

    return cv2.resize(mask, (width, height), interpolation=cv2.INTER_LINEAR)


def with_masks(scene: Scene, masks: Sequence[np.ndarray] | None) -> Scene:
    """Return the scene with other masks [H,W] uint8 for its training views, in their order; unchanged for None."""
    if masks is None:
        return scene
    return replace(scene, train=[replace(view, alpha=mask) for view, mask in zip(scene.train, masks, strict=True)])


def leave_borders_free(masks: Sequence[np.ndarray], options: MaskUseOptions = MaskUseOptions()) -> bool:
    """Return whether masks [H,W] uint8 leave the images' borders to the background.

    Masks of an object before a plain backdrop do.
    """
    return 1 - white_borders(masks) >= options.free_border


def white_borders(masks: Sequence[np.ndarray]) -> float:
    """Return the share of the border pixels of masks [H,W] uint8 that are white."""
    borders = [np.concatenate([mask[0], mask[-1], mask[:, 0], mask[:, -1]]) for mask in masks]
    return float((np.concatenate(borders) >= 128).mean())


def inverted_masks(masks: Sequence[np.ndarray]) -> bool:
    """Return whether masks [H,W] uint8 are white around a black object.

    This is so if, in nearly all views, the border is white and the black part lies in the middle.
    """
    return sum(map(_looks_inverted, masks)) > 0.9 * len(masks)


def _looks_inverted(mask: np.ndarray) -> bool:
    """Return whether a mask [H,W] uint8 is white along nearly the whole border and black around the middle."""
    border = np.concatenate([mask[0], mask[-1], mask[:, 0], mask[:, -1]])
    if (border > 127).mean() < 0.95:
        return False
    rows, cols = np.nonzero(mask < 128)
    # A few specks of black are holes in a mask of something that fills the picture.
    if len(rows) < 0.01 * mask.size:
        return False
    middle = rows.mean() / mask.shape[0], cols.mean() / mask.shape[1]
    return all(0.2 < place < 0.8 for place in middle)
