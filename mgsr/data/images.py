"""Images: decoding to 8-bit sRGB, reduction by area, compositing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from mgsr.errors import SceneError


def image_size(path: Path, source: str) -> tuple[int, int]:
    """Width and height from the file's header. Raises SceneError; `source` names the file that asks for the image."""
    handle = _open(path, source)
    spec = handle.spec()
    handle.close()
    return spec.width, spec.height


def read_image(path: Path, source: str) -> tuple[np.ndarray, np.ndarray | None]:
    """Colours [H,W,3] uint8 sRGB, straight, and the alpha channel [H,W] uint8 or None where the file has none.

    Grey images become RGB; float images (EXR, HDR) are taken as linear light. Pixels stay as they are stored: like
    COLMAP, this does not turn photographs by their EXIF orientation.
    """
    pixels = _read_pixels(path, source)
    count = pixels.shape[2]
    alpha = np.ascontiguousarray(pixels[..., -1]) if count in (2, 4) else None
    colors = pixels[..., :3] if count >= 3 else np.repeat(pixels[..., :1], 3, axis=2)
    return np.ascontiguousarray(colors), alpha


def read_mask(path: Path, source: str) -> np.ndarray:
    """A mask [H,W] uint8, 255 on the object: the alpha channel if it says something, else the brightness.

    Masks with the values 0 and 1 are spread to 0 and 255.
    """
    colors, alpha = read_image(path, source)
    mask = alpha if alpha is not None and alpha.min() < 255 else colors.max(axis=2)
    return mask * np.uint8(255) if mask.max() == 1 else mask


def reduce_area(image: np.ndarray, width: int, height: int) -> np.ndarray:
    """The image [H,W,C] at a smaller size, float32: each pixel is the exact mean over the area that it covers."""
    return _reduce_rows(_reduce_rows(image, height).swapaxes(0, 1), width).swapaxes(0, 1)


def composite_on_white(colors: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Colours [H,W,3] uint8 over white, by alpha [H,W] uint8."""
    opacity = alpha[..., None].astype(np.float32) / 255
    return to_uint8(colors * opacity + 255 * (1 - opacity))


def to_uint8(values: np.ndarray) -> np.ndarray:
    """Values in 0..255, rounded and clipped."""
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


def _reduce_rows(image: np.ndarray, count: int) -> np.ndarray:
    """Means over `count` equal spans of the first axis, from differences of the running sum at fractional places."""
    size = image.shape[0]
    sums = np.concatenate([np.zeros_like(image[:1], dtype=np.float64), np.cumsum(image, axis=0, dtype=np.float64)])
    edges = np.linspace(0, size, count + 1)
    low = np.minimum(edges.astype(int), size - 1)
    part = (edges - low)[:, None, None]
    at_edges = sums[low] * (1 - part) + sums[low + 1] * part
    return (np.diff(at_edges, axis=0) * (count / size)).astype(np.float32)


def _read_pixels(path: Path, source: str) -> np.ndarray:
    handle = _open(path, source)
    spec = handle.spec()
    is_float = str(spec.format) in ("half", "float", "double")
    pixels = handle.read_image(0, 0, 0, spec.nchannels, "float" if is_float else "uint8")
    trouble = handle.geterror()
    handle.close()
    if pixels is None or trouble:
        raise SceneError(f"{path.name}: damaged image: {trouble.strip() or 'no pixels'} (asked for by {source})")
    pixels = pixels.reshape(spec.height, spec.width, spec.nchannels)[..., :4]
    return _encode_srgb(pixels) if is_float else pixels


def srgb_to_linear(colors: np.ndarray) -> np.ndarray:
    """sRGB values 0..1 as linear light (IEC 61966-2-1)."""
    return np.where(colors <= 0.04045, colors / 12.92, ((colors + 0.055) / 1.055) ** 2.4)


def _encode_srgb(linear: np.ndarray) -> np.ndarray:
    """8-bit sRGB from linear light, by IEC 61966-2-1; alpha (the last of 2 or 4 channels) is left linear."""
    light = np.clip(np.nan_to_num(linear), 0, 1)
    curve = np.where(light <= 0.0031308, light * 12.92, 1.055 * np.power(light, 1 / 2.4) - 0.055)
    if linear.shape[2] in (2, 4):
        curve[..., -1] = light[..., -1]
    return to_uint8(curve * 255)


def _open(path: Path, source: str) -> Any:
    # Late, so that what has its images already (a training run on another machine) needs no OpenImageIO.
    import OpenImageIO

    if not path.is_file():
        raise SceneError(f"image {path} is missing (asked for by {source}); put it there or remove the view")
    config = OpenImageIO.ImageSpec()
    config.attribute("oiio:UnassociatedAlpha", 1)  # else colours come multiplied by alpha
    handle = OpenImageIO.ImageInput.open(str(path), config)
    if handle is None:
        reason = OpenImageIO.geterror().strip()
        raise SceneError(f"{path.name}: not an image that can be read: {reason} (asked for by {source})")
    return handle
