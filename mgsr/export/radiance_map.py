"""`environment.exr`: the light that a surface mirrors or that shades it, for rendering the surface in its own light.

It is linear radiance in the unit of the photographs' linear light, where 1 is white, for all directions about the
surface. The frame is that of model.glb, y up. The picture is OpenEXR's latitude-longitude map: its top row is +y, its
middle column +z, and +x lies to the left of the middle.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenImageIO

from mgsr.errors import MgsrError
from mgsr.export.gltf import UpDirection, turn_upright
from mgsr.shading.environment_fit import sample_map

ROWS = 128  # of the picture; columns are twice as many


def write_radiance_map(path: Path, light: np.ndarray, up: UpDirection) -> None:
    """Write an environment as OpenEXR of half floats.

    light [H,2H,3]: linear radiance, rows by the polar angle from the frame's z, columns by the azimuth from its x. up:
    as for `glb`. Raises MgsrError where the file cannot be written.
    """
    rows, columns = np.mgrid[:ROWS, : 2 * ROWS] + 0.5
    latitude, longitude = np.pi * (0.5 - rows / ROWS), np.pi * (1 - columns / ROWS)
    flat = np.cos(latitude)
    directions = np.stack([flat * np.sin(longitude), np.sin(latitude), flat * np.cos(longitude)], axis=-1)
    own = directions.reshape(-1, 3) @ turn_upright(up)
    picture = (sample_map(own, len(light)) @ light.reshape(-1, 3)).reshape(ROWS, 2 * ROWS, 3).astype(np.float32)
    spec = OpenImageIO.ImageSpec(2 * ROWS, ROWS, 3, "half")
    spec.attribute("textureformat", "LatLong Environment")
    spec.attribute("DateTime", "1970:01:01 00:00:00")  # the time of writing would make equal runs' files differ
    spec.attribute("ImageDescription", "linear radiance about the object, in the frame of model.glb, y up, +z amidst")
    image = OpenImageIO.ImageBuf(spec)
    image.set_pixels(OpenImageIO.ROI(), picture)
    if not image.write(str(path), fileformat="openexr"):
        raise MgsrError(f"{path}: the environment cannot be written: {image.geterror()}")
