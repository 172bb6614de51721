"""`mirrored_light.npz`: the environment maps that the surface reflects, which all splats share.

`scene` and `camera`, [S,S,3] float32, are maps of the light from each direction, with colours 0..1 as in the images.
`scene` has the user's axes. `camera` has OpenCV's axes with z reversed, so that its centre points back to the camera.
Each map unfolds the octahedron |x|+|y|+|z| = 1 of the directions into a square. A direction with z >= 0 lies at column
(x+1)/2 and row (y+1)/2 of the side. Other directions are folded out over the corners. A render of the 3D branch is

    transmitted + weight x (reflected + scene[where the surface reflects to] + camera[where it reflects to]).

The surface that reflects is the mesh of `vertices` [V,3] and `faces` [F,3], in the user's frame. Where the reflected
ray meets the mesh again, it is reflected once more, and both maps' light is multiplied by `bounce` [3]. Without a mesh,
the 2D branch reflects the maps by its normals, blended in each pixel. If the origin of the user's frame is far away,
there is also `origin` [3] (see `far_origin.py`). The vertices' places in the frame are then `vertices` plus `origin`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mgsr.data.npz import read_arrays
from mgsr.errors import SceneError, in_short
from mgsr.export.far_origin import no_origin
from mgsr.geometry.mesh import Mesh

_PARTS = ("scene", "camera")


@dataclass(frozen=True)
class StoredEnvironmentMap:
    """The environment maps of a scene.

    maps [2,3,S,S] (the scene's, then the camera's) and bounce [3], 0..1. surface: the mesh that
    reflects, in the user's frame, None where the 2D branch does.
    """

    maps: np.ndarray
    bounce: np.ndarray
    surface: Mesh | None = None


def write_environment_map(path: Path, stored: StoredEnvironmentMap, origin: np.ndarray | None = None) -> None:
    """Write the maps. origin [3]: the origin of the file's vertices, None for the frame's own."""
    images = np.moveaxis(np.asarray(stored.maps, np.float32), 1, -1)
    arrays: dict[str, Any] = dict(zip(_PARTS, images, strict=True))
    arrays["bounce"] = np.asarray(stored.bounce, np.float32)
    if stored.surface is not None:
        about = no_origin() if origin is None else origin
        arrays["vertices"] = (stored.surface.vertices - about).astype(np.float32)
        arrays["faces"] = stored.surface.faces.astype(np.int32)
        if about.any():
            arrays["origin"] = about
    with path.open("wb") as file:
        np.savez_compressed(file, **arrays)


def load_environment_map(path: Path) -> StoredEnvironmentMap:
    """Read the maps. Raises SceneError for a file that holds no maps."""
    try:
        content = read_arrays(path)
        images = [content[part].astype(np.float32) for part in _PARTS]
        bounce = content.get("bounce", np.ones(3)).astype(np.float32)
        surface = _surface(content)
    except (ValueError, KeyError) as error:
        raise SceneError(
            f"{path}: the file holds no environment map ({in_short(error)}); train again, or remove it"
        ) from error
    side = images[0].shape[0] if images[0].ndim else 0
    if bounce.shape != (3,) or any(image.shape != (side, side, 3) or not side for image in images):
        shapes = ", ".join(str(array.shape) for array in (*images, bounce))
        raise SceneError(f"{path}: expected two maps [S,S,3] and a bounce [3], got {shapes}; train again, or remove it")
    if not all(np.isfinite(array).all() for array in (*images, bounce)):
        raise SceneError(f"{path}: expected finite numbers in maps and bounce; train again, or remove it")
    return StoredEnvironmentMap(np.moveaxis(np.stack(images), -1, 1), bounce, surface)


def _surface(content: dict[str, np.ndarray]) -> Mesh | None:
    """Return the mesh that reflects. Raises ValueError where it is damaged, KeyError where half of it is missing."""
    if "vertices" not in content and "faces" not in content:
        return None
    vertices, faces = content["vertices"].astype(float), content["faces"].astype(np.int64)
    origin = content.get("origin", no_origin()).astype(float)
    right = vertices.ndim == faces.ndim == 2 and vertices.shape[1] == faces.shape[1] == 3 == origin.size
    if not right or not len(faces) or faces.min() < 0 or faces.max() >= len(vertices):
        raise ValueError(f"mesh: expected vertices [V,3] and faces [F,3], got {vertices.shape}, {faces.shape}")
    if not (np.isfinite(vertices).all() and np.isfinite(origin).all()):
        raise ValueError("mesh: expected finite vertices")
    return Mesh(vertices + origin, faces)
