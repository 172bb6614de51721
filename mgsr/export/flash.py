"""`flash.npz`: a flash on the camera, and the surface that it lights, as a run found them before training.

- `vertices` [V,3], `faces` [F,3]: the surface, in the user's frame.
- `besides` [V]: the ambient light at each vertex, which does not come from the lamp.
- `like` [V]: the index of the proxy vertex from which each vertex takes position, normal and light. It is another
  vertex where no photograph confirms the vertex itself.
- `lamp` [3]: the lamp's offset to the right of the lens and its offset below the lens, in the user's unit, and its
  irradiance on a surface that faces it at a distance of 1.

Light is relative to the brightest light in the photographs. The splats' transmitted colours are those under even light.
In a pixel with the light l, the transmitted colour c, in sRGB, becomes (c + 0.055) l^(1/2.4) - 0.055.

If the origin of the user's frame is far away, there is also `origin` [3] (see `far_origin.py`). The vertices' places in
the frame are then `vertices` plus `origin`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from mgsr.data.npz import read_arrays
from mgsr.errors import SceneError, in_short
from mgsr.export.far_origin import no_origin
from mgsr.geometry.mesh import Mesh
from mgsr.shading.lighting import Lighting


def write_flash(path: Path, lighting: Lighting, origin: np.ndarray | None = None) -> None:
    """Write a flash, in the user's frame. origin [3]: the origin of the file's vertices, None for the frame's own."""
    about = no_origin() if origin is None else origin
    arrays: dict[str, Any] = {
        "vertices": (lighting.mesh.vertices - about).astype(np.float32),
        "faces": lighting.mesh.faces.astype(np.int32),
        "besides": lighting.ambient.astype(np.float32),
        "like": lighting.proxy_vertex.astype(np.int32),
        "lamp": np.array([lighting.right, lighting.down, lighting.lamp]),
    }
    if about.any():
        arrays["origin"] = about
    with path.open("wb") as file:
        np.savez_compressed(file, **arrays)


def load_flash(path: Path) -> Lighting:
    """Load a flash, in the user's frame. Raises SceneError for a file that holds no flash."""
    try:
        content = read_arrays(path)
        vertices, ambient, lamp = (content[name].astype(float) for name in ("vertices", "besides", "lamp"))
        faces, proxy_vertex = content["faces"].astype(np.int64), content["like"].astype(np.int64)
        origin = content.get("origin", no_origin()).astype(float)
    except (ValueError, KeyError) as error:
        raise SceneError(f"{path}: the file holds no flash ({in_short(error)}); train again, or remove it") from error
    count = len(vertices)
    right = vertices.shape == (count, 3) and ambient.shape == proxy_vertex.shape == (count,)
    right = right and lamp.shape == origin.shape == (3,)
    right = right and faces.ndim == 2 and faces.shape[1] == 3 and len(faces) > 0
    right = right and all(indices.min() >= 0 and indices.max() < count for indices in (faces, proxy_vertex))
    if not right or not all(np.isfinite(array).all() for array in (vertices, ambient, lamp, origin)):
        raise SceneError(
            f"{path}: expected finite vertices [V,3], besides [V], lamp [3] and origin [3], and indices faces [F,3] "
            f"and like [V], got {vertices.shape}, {ambient.shape}, {lamp.shape}, {origin.shape}, "
            f"{faces.shape}, {proxy_vertex.shape}; train again, or remove it"
        )
    return Lighting(Mesh(vertices + origin, faces), ambient, proxy_vertex, *lamp.tolist())
