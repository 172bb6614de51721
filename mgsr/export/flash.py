"""`flash.npz`: a flash on the camera, and the surface that it lights, as a run found them before training.

Arrays: `vertices` [V,3] and `faces` [F,3] of the surface, in the user's frame; `besides` [V], the light at each vertex
that is not the lamp's; `like` [V], the vertex whose place, normal and light each takes, as photographs do not confirm
its own; `lamp` [3]: how far the lamp is to the right of the lens and below it, in the user's unit, and
the light that it sends to a surface that faces it at a distance of 1. Light is a share of the brightest in the
photographs. The splats' transmitted colours are those under even light; in a pixel that gets the light l, the
transmitted colour c, in sRGB, becomes (c + 0.055) l^(1/2.4) - 0.055.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mgsr.data.npz import read_arrays
from mgsr.errors import SceneError, in_short
from mgsr.shading.lighting import Lighting


def write_flash(path: Path, lighting: Lighting) -> None:
    """Write a flash, in the user's frame."""
    with path.open("wb") as file:
        np.savez_compressed(
            file,
            vertices=lighting.vertices.astype(np.float32),
            faces=lighting.faces.astype(np.int32),
            besides=lighting.besides.astype(np.float32),
            like=lighting.like.astype(np.int32),
            lamp=np.array([lighting.right, lighting.down, lighting.lamp]),
        )


def load_flash(path: Path) -> Lighting:
    """A flash, in the user's frame. Raises SceneError for a file that is none."""
    try:
        content = read_arrays(path)
        vertices, besides, lamp = (content[name].astype(float) for name in ("vertices", "besides", "lamp"))
        faces, like = content["faces"].astype(np.int64), content["like"].astype(np.int64)
    except (ValueError, KeyError) as error:
        raise SceneError(f"{path}: not a flash ({in_short(error)}); train again, or remove it") from error
    count = len(vertices)
    right = vertices.shape == (count, 3) and besides.shape == like.shape == (count,) and lamp.shape == (3,)
    right = right and faces.ndim == 2 and faces.shape[1] == 3 and len(faces) > 0
    right = right and all(indices.min() >= 0 and indices.max() < count for indices in (faces, like))
    if not right or not all(np.isfinite(array).all() for array in (vertices, besides, lamp)):
        raise SceneError(
            f"{path}: expected vertices [V,3], besides [V], lamp [3] of finite numbers, faces [F,3] and like [V] of "
            f"indices, got {vertices.shape}, {besides.shape}, {lamp.shape}, {faces.shape}, {like.shape}; train again, "
            "or remove it"
        )
    return Lighting(vertices, faces, besides, like, *lamp.tolist())
