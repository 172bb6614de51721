"""Encode pictures as data URLs, so that a page needs no second file."""

from __future__ import annotations

import base64
import tempfile
from pathlib import Path

import numpy as np

from mgsr.data.images import reduce_area, to_uint8
from mgsr.errors import MgsrError

QUALITY = 88  # of WebP, 0 to 100: no visible blocks in normals and smooth shading
EFFORT = 4  # of WebP, 0 to 6: with alpha, the highest efforts take a hundred times as long, and save 3%


def data_address(pixels: np.ndarray, max_side: int) -> str:
    """Return a picture uint8 [H,W,3] or [H,W,4] as `data:image/webp;base64,...`, reduced if a side exceeds max_side."""
    return "data:image/webp;base64," + base64.b64encode(webp(shrunk(pixels, max_side))).decode()


def shrunk(pixels: np.ndarray, max_side: int) -> np.ndarray:
    """Reduce a picture [H,W,3] or [H,W,4] uint8 so that no side is longer than max_side.

    Colours are weighted by alpha, so that no fringe appears.
    """
    height, width = pixels.shape[:2]
    factor = max_side / max(height, width)
    if factor >= 1:
        return pixels
    size = max(1, round(width * factor)), max(1, round(height * factor))
    if pixels.shape[2] == 3:
        return to_uint8(reduce_area(pixels, *size))
    alpha = pixels[..., 3:].astype(np.float32)
    mean = reduce_area(np.concatenate([pixels[..., :3] * (alpha / 255), alpha], axis=-1), *size)
    mean[..., :3] /= np.maximum(mean[..., 3:] / 255, 1e-6)
    return to_uint8(mean)


def webp(pixels: np.ndarray) -> bytes:
    """Encode a picture [H,W,3] or [H,W,4] uint8 as a WebP file.

    Raises MgsrError if OpenImageIO can't write one.
    """
    import OpenImageIO

    spec = OpenImageIO.ImageSpec(pixels.shape[1], pixels.shape[0], pixels.shape[2], "uint8")
    spec.attribute("oiio:UnassociatedAlpha", 1)
    spec.attribute("webp:method", EFFORT)
    spec.attribute("Compression", f"webp:{QUALITY}")
    # OpenImageIO's Python side writes to files only.
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "picture.webp"
        output = OpenImageIO.ImageOutput.create(str(path))
        if output is None or not output.open(str(path), spec):
            raise MgsrError(f"report: OpenImageIO can't write WebP: {OpenImageIO.geterror()}; reinstall OpenImageIO")
        written = output.write_image(np.ascontiguousarray(pixels))
        output.close()
        if not written:
            raise MgsrError(f"report: a picture could not be written: {output.geterror()}; check the temporary folder")
        return path.read_bytes()
