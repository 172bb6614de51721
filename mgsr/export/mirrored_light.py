"""`mirrored_light.npz`: the light that the surface mirrors, which all splats share.

Two arrays, `scene` and `camera`, [S,S,3] float32, colours 0..1 as in the images: maps of the light from each direction,
still in the scene (the user's axes), and fixed to the camera (OpenCV axes with z turned, so that the middle is the way
back to the camera). Each unfolds the directions' octahedron |x|+|y|+|z| = 1 into a square: a direction with z >= 0 lies
at column (x+1)/2 and row (y+1)/2 of the side, others folded out over the corners. A render of the 3D branch is

    transmitted + weight x (reflected + scene[where the surface mirrors to] + camera[where it mirrors to]),

the surface's normals being the 2D branch's, blended in each pixel.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mgsr.data.npz import read_arrays
from mgsr.errors import SceneError, in_short

_PARTS = ("scene", "camera")


def write_mirrored_light(path: Path, maps: np.ndarray) -> None:
    """Write both maps [2,3,S,S] (the scene's, then the camera's), 0..1."""
    images = np.moveaxis(np.asarray(maps, np.float32), 1, -1)
    with path.open("wb") as file:
        np.savez_compressed(file, **dict(zip(_PARTS, images, strict=True)))


def load_mirrored_light(path: Path) -> np.ndarray:
    """Both maps [2,3,S,S] float32. Raises SceneError for a file that is none of these."""
    try:
        content = read_arrays(path)
        images = [content[part].astype(np.float32) for part in _PARTS]
    except (ValueError, KeyError) as error:
        raise SceneError(f"{path}: not a mirrored light ({in_short(error)}); train again, or remove it") from error
    side = images[0].shape[0]
    if any(image.shape != (side, side, 3) or not np.isfinite(image).all() for image in images):
        shapes = ", ".join(str(image.shape) for image in images)
        raise SceneError(f"{path}: expected two maps [S,S,3] of finite numbers, got {shapes}; train again or remove it")
    return np.moveaxis(np.stack(images), -1, 1)
