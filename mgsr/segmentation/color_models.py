"""Colour models of the object and of the support plane, from pixels that certainly show one of them.

Often too few photographs show a place under the object or between its parts for photo-consistency. But its colour can
be compared with the colours of the object and of the plane around it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from mgsr.config.expert import ColorModelOptions
from mgsr.data.camera import Camera
from mgsr.geometry.raycast import pixel_rays
from mgsr.segmentation.support_plane import SupportPlane


@dataclass(frozen=True)
class ColorModels:
    """Samples of the object's and of the support plane's colours, sRGB 0..1, and the options of their comparison.

    The distance of a colour from a model is its distance to the `neighbours`-th nearest sample. So a few stray samples
    have no effect (k-nearest-neighbour density estimation, Loftsgaarden and Quesenberry 1965).
    """

    object: cKDTree
    support: cKDTree
    options: ColorModelOptions

    def costs(self, colors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the uncapped costs [P] of the labels object and background at colours [P,3], sRGB 0..1."""
        return self._cost(self.object, colors), self._cost(self.support, colors)

    def _cost(self, samples: cKDTree, colors: np.ndarray) -> np.ndarray:
        """Return the costs [P] of colours [P,3] under one model."""
        distances = samples.query(colors, k=[self.options.neighbours])[0][:, 0]
        return np.asarray(distances**2 / (2 * self.options.deviation**2))


def color_models(
    images: Sequence[np.ndarray],
    objects: Sequence[np.ndarray],
    supports: Sequence[np.ndarray],
    options: ColorModelOptions = ColorModelOptions(),
) -> ColorModels | None:
    """Sample the colour models from photographs `images` [H,W,3] uint8 sRGB; None if too few pixels are certain.

    objects, supports [H,W] bool: the pixels of each photograph that certainly show the object and the support plane.
    The same photographs give the same models.
    """
    generator = np.random.default_rng(0)
    trees: list[cKDTree] = []
    for masks, darkest in ((objects, 1.0), (supports, options.darkest)):
        colors = np.concatenate([image[mask] for image, mask in zip(images, masks, strict=True)]) / np.float32(255)
        if len(colors) < options.neighbours:
            return None
        drawn = colors[generator.integers(0, len(colors), options.samples)]
        shades = np.linspace(1, darkest, options.shades if darkest < 1 else 1, dtype=np.float32)
        trees.append(cKDTree((shades[:, None, None] * drawn).reshape(-1, 3)))
    return ColorModels(trees[0], trees[1], options)


def near_on_plane(camera: Camera, plane: SupportPlane, middle: np.ndarray, reach: float) -> np.ndarray:
    """Return the pixels [H,W] bool whose rays meet a plane within a distance of a point [3] in the world frame.

    reach: the distance, in the world's unit.
    """
    rays = pixel_rays(camera)
    depth = plane.depth(camera.center, rays)
    ahead = np.isfinite(depth)
    hit = camera.center + rays * np.where(ahead, depth, 0)[..., None]
    return np.asarray(ahead & (np.linalg.norm(hit - middle, axis=-1) < reach))
