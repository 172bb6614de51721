"""Images: decoding to 8-bit sRGB, reduction by area, compositing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mgsr.data.channels import Channels, find_channels
from mgsr.data.odd_files import what_instead
from mgsr.errors import SceneError, in_short

# No camera has more pixels in one picture; files that claim more would fill the memory.
MAX_PIXELS = 1 << 28

# Float TIFFs hold 0 to 1; where most values above 0 exceed this, the file has another range.
_MOST_IN_FLOAT = 1.5

_FLOATS = ("half", "float", "double")
_HEIF_ERRORS = (ValueError, EOFError, SyntaxError, OSError, RuntimeError, IndexError)  # what pillow-heif raises


@dataclass(frozen=True)
class DecodedImage:
    """A decoded image file.

    colors [H,W,3] uint8 sRGB, not premultiplied; alpha [H,W] uint8 or None. orientation: EXIF's number from 1 to 8,
    which says how to turn the stored pixels upright.
    """

    colors: np.ndarray
    alpha: np.ndarray | None
    orientation: int = 1


def image_size(path: Path, source: str) -> tuple[int, int]:
    """Return the width and height of the image that `read_picture` returns, from the file's header.

    source: the file that asks for the image. Raises SceneError for files that can't be read or exceed MAX_PIXELS.
    """
    if is_heif(path):
        width, height = _open_heif(path, source).size
        return width, height
    handle = _open(path, source)
    window = _shown_window(handle)
    handle.close()
    return window.width, window.height


def is_heif(path: Path) -> bool:
    """Return whether the file's content belongs to the HEIC family, whatever its name.

    Phones and messengers rename such files to .jpg, and back.
    """
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(8)[4:] == b"ftyp"


def read_image(path: Path, source: str) -> tuple[np.ndarray, np.ndarray | None]:
    """Return the colours [H,W,3] and alpha [H,W] of `read_picture`."""
    picture = read_picture(path, source)
    return picture.colors, picture.alpha


def read_picture(path: Path, source: str) -> DecodedImage:
    """Read the file's pixels as they are stored, not turned by their EXIF orientation.

    Grey and CMYK images become RGB. Files that say they are linear, and float images without such a tag (EXR, HDR), get
    the sRGB curve. All others are taken as sRGB, whatever their depth. Premultiplied colours (EXR, TIFF) are divided by
    alpha before the curve. An EXR yields its display window, black and transparent where the file has no pixels. Raises
    SceneError naming the file.
    """
    if is_heif(path):
        return _read_heif(path, source)
    pixels, channels, orientation = _read_pixels(path, source)
    alpha = None if channels.alpha is None else np.ascontiguousarray(pixels[..., -1])
    colors = pixels[..., : len(channels.colors)]
    return DecodedImage(_as_rgb(colors), alpha, orientation)


def upright(pixels: np.ndarray, orientation: int) -> np.ndarray:
    """Return stored pixels [H,W,...] turned and mirrored as EXIF's orientation says (Exif 2.32, "Orientation")."""
    if orientation in (5, 6, 7, 8):
        pixels = pixels.swapaxes(0, 1)
    if orientation in (3, 4, 7, 8):
        pixels = pixels[::-1]
    if orientation in (2, 3, 6, 7):
        pixels = pixels[:, ::-1]
    return np.ascontiguousarray(pixels)


def read_mask(path: Path, source: str) -> np.ndarray:
    """Read a mask [H,W] uint8, 255 on the object, from the alpha channel unless it is all opaque, else the brightness.

    Masks with the values 0 and 1 are spread to 0 and 255. Raises SceneError naming the file.
    """
    colors, alpha = read_image(path, source)
    mask = alpha if alpha is not None and alpha.min() < 255 else colors.max(axis=2)
    return mask * np.uint8(255) if mask.max() == 1 else mask


def reduce_area(image: np.ndarray, width: int, height: int) -> np.ndarray:
    """Return the image [H,W,C] at a smaller size, float32; each pixel is the exact mean over its area."""
    import cv2  # imported here, because training needs no OpenCV

    pixels = np.ascontiguousarray(image, np.float32)
    reduced = cv2.resize(pixels, (width, height), interpolation=cv2.INTER_AREA)
    return reduced.reshape(height, width, image.shape[2])


def composite_on_white(colors: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Composite colors [H,W,3] uint8 over white by alpha [H,W] uint8."""
    opacity = alpha[..., None].astype(np.float32) / 255
    return to_uint8(colors * opacity + 255 * (1 - opacity))


def to_uint8(values: np.ndarray) -> np.ndarray:
    """Round values [...] to the nearest integer, and clip them to uint8."""
    rounded = np.rint(values)
    clipped: np.ndarray = np.clip(rounded, 0, 255, out=rounded).astype(np.uint8)
    return clipped


def srgb_to_linear(colors: np.ndarray) -> np.ndarray:
    """Convert sRGB values [...], 0..1, to linear light 0..1 (IEC 61966-2-1)."""
    return np.where(colors <= 0.04045, colors / 12.92, ((colors + 0.055) / 1.055) ** 2.4)


def srgb_rate(colors: np.ndarray) -> np.ndarray:
    """Return the derivative of the sRGB curve with respect to linear light, at sRGB values [...], 0..1."""
    return np.where(colors <= 0.04045, 12.92, 1.055 / 2.4 * ((colors + 0.055) / 1.055) ** -1.4)


def linear_to_srgb(light: np.ndarray) -> np.ndarray:
    """Convert linear light [...], 0..1, to sRGB values 0..1 (IEC 61966-2-1)."""
    return np.where(light <= 0.0031308, light * 12.92, 1.055 * np.power(light, 1 / 2.4) - 0.055)


def _encode_srgb(linear: np.ndarray, has_alpha: bool) -> np.ndarray:
    """Convert linear light [H,W,C], 0..1, to 8-bit sRGB; an alpha channel, the last one, stays linear."""
    curve = linear_to_srgb(linear)
    if has_alpha:
        curve[..., -1] = linear[..., -1]
    return to_uint8(curve * 255)


def _as_rgb(colors: np.ndarray) -> np.ndarray:
    """Return colours [H,W,3] of an image with one channel or three, [H,W,1] or [H,W,3]."""
    return np.repeat(colors, 3, axis=2) if colors.shape[2] == 1 else np.ascontiguousarray(colors)


def _read_pixels(path: Path, source: str) -> tuple[np.ndarray, Channels, int]:
    """Read the colours and, where there is one, alpha [H,W,1..4] uint8, with their channels and EXIF's orientation."""
    handle = _open(path, source)
    window = _shown_window(handle)
    channels = find_channels(handle, path.name, source)
    spec = handle.spec()
    _check_size(path, spec.width, spec.height, source)
    pixels = _in_window(_decoded(handle, channels, path, source), spec, window)
    if pixels.dtype != np.uint8:
        if handle.format_name() == "tiff":
            _check_range(path, pixels, source)
        pixels = _as_bytes(pixels, channels, _is_linear(spec))
    handle.close()
    orientation = spec.getattribute("Orientation")
    return pixels, channels, orientation if orientation in range(1, 9) else 1


def _decoded(handle: Any, channels: Channels, path: Path, source: str) -> np.ndarray:
    """Decode the wanted channels [h,w,1..4] of the file: uint8, or float32 where values must be computed.

    Raises SceneError for damaged files.
    """
    spec = handle.spec()
    as_float = channels.multiplied or _is_linear(spec) or str(spec.format) in _FLOATS
    first, end = min(channels.all), max(channels.all) + 1
    pixels = handle.read_image(channels.part, 0, first, end, "float" if as_float else "uint8")
    trouble = _trouble(handle.geterror)
    if pixels is None or trouble:
        raise SceneError(
            f"{path.name}: the image is damaged: {trouble or 'no pixels'} (named by {source}); copy it again"
        )
    decoded: np.ndarray = pixels.reshape(spec.height, spec.width, end - first)
    if channels.all == tuple(range(first, end)):
        return decoded
    return decoded[..., [channel - first for channel in channels.all]]


def _as_bytes(pixels: np.ndarray, channels: Channels, is_linear: bool) -> np.ndarray:
    """Convert float pixels [H,W,C] to 8-bit sRGB, not premultiplied.

    An alpha channel, the last one, stays linear.
    """
    pixels = np.clip(np.nan_to_num(_divided(pixels) if channels.multiplied else pixels), 0, 1)
    return _encode_srgb(pixels, channels.alpha is not None) if is_linear else to_uint8(pixels * 255)


def _check_range(path: Path, pixels: np.ndarray, source: str) -> None:
    """Raise SceneError if most float pixels [H,W,C] are brighter than 1."""
    bright = pixels[..., 0] > 0
    if bright.any() and np.median(pixels[..., 0][bright]) > _MOST_IN_FLOAT:
        raise SceneError(
            f"{path.name}: expected linear light from 0 to 1, got float values up to {pixels.max():.4g}; divide them, "
            f"or save 8 or 16 bits (named by {source})"
        )


def _divided(pixels: np.ndarray) -> np.ndarray:
    """Divide premultiplied colours by alpha, the last channel of pixels [H,W,C]."""
    alpha = pixels[..., -1:]
    with np.errstate(over="ignore"):  # for alpha near zero
        straight = pixels / np.where(alpha > 0, alpha, 1)
    straight[..., -1:] = alpha
    return straight


@dataclass(frozen=True)
class _Window:
    """A rectangle of pixels; x and y are its left upper corner in the file's own pixels."""

    x: int
    y: int
    width: int
    height: int


def _shown_window(handle: Any) -> _Window:
    """Return the window to show: an EXR's display window, otherwise the file's own pixels.

    An EXR's pixels may lie around its display window or within it.
    """
    spec = handle.spec()
    if handle.format_name() != "openexr":
        return _Window(spec.x, spec.y, spec.width, spec.height)
    return _Window(spec.full_x, spec.full_y, spec.full_width, spec.full_height)


def _in_window(pixels: np.ndarray, spec: Any, window: _Window) -> np.ndarray:
    """Return the pixels [H,W,C] inside the window, with 0 where the file has no pixels."""
    if window == _Window(spec.x, spec.y, spec.width, spec.height):
        return pixels
    placed = np.zeros((window.height, window.width, pixels.shape[2]), pixels.dtype)
    left, top = spec.x - window.x, spec.y - window.y
    inside = placed[max(top, 0) : max(top + spec.height, 0), max(left, 0) : max(left + spec.width, 0)]
    height, width = inside.shape[:2]
    inside[:] = pixels[max(-top, 0) :, max(-left, 0) :][:height, :width]
    return placed


def _is_linear(spec: Any) -> bool:
    space = spec.getattribute("oiio:ColorSpace")
    if space is None:
        return str(spec.format) in _FLOATS
    return str(space).lower().startswith("lin")


def _trouble(geterror: Callable[[], str]) -> str:
    """Return OpenImageIO's last error in short; empty if there was none."""
    try:
        return in_short(geterror())
    except UnicodeDecodeError as error:  # it puts a damaged file's own bytes into its text
        return in_short(error.object.decode(errors="replace"))


def _open(path: Path, source: str) -> Any:
    # Imported here, because training on another machine has decoded images and needs no OpenImageIO.
    import OpenImageIO

    _check_there(path, source)
    config = OpenImageIO.ImageSpec()
    config.attribute("oiio:UnassociatedAlpha", 1)  # else colours come multiplied by alpha
    handle = OpenImageIO.ImageInput.open(str(path), config)
    if handle is None:
        reason = _trouble(OpenImageIO.geterror) or "unknown type"
        if odd := what_instead(path):
            raise SceneError(f"{path.name} {odd} (named by {source})")
        cure = "reduce it" if "exceed" in reason else "copy it again"  # OpenImageIO applies its own limits first
        raise SceneError(f"{path.name}: this file is not a readable image: {reason} (named by {source}); {cure}")
    spec, window = handle.spec(), _shown_window(handle)
    for width, height in ((spec.width, spec.height), (window.width, window.height)):
        _check_size(path, width, height, source)
    return handle


def _open_heif(path: Path, source: str) -> Any:
    import pillow_heif  # imported here, because few captures need it

    _check_there(path, source)
    try:
        opened = pillow_heif.open_heif(path, convert_hdr_to_8bit=True)
        width, height = opened.size
    except _HEIF_ERRORS as error:
        raise SceneError(
            f"{path.name}: this file is not a readable image: {in_short(error)} (named by {source}); copy it again"
        ) from error
    _check_size(path, width, height, source)
    return opened


def _read_heif(path: Path, source: str) -> DecodedImage:
    """Read a HEIC file. Its decoder turns the pixels upright, so the orientation is always 1.

    Raises SceneError for damaged files.
    """
    opened = _open_heif(path, source)
    try:
        pixels = np.asarray(opened)
    except _HEIF_ERRORS as error:
        reason = in_short(error)
        raise SceneError(f"{path.name}: the image is damaged: {reason} (named by {source}); copy it again") from error
    pixels = pixels.reshape(*pixels.shape[:2], -1)
    alpha = np.ascontiguousarray(pixels[..., -1]) if pixels.shape[2] in (2, 4) else None
    return DecodedImage(_as_rgb(pixels[..., : 1 if pixels.shape[2] < 3 else 3]), alpha)


def _check_there(path: Path, source: str) -> None:
    if not path.is_file():
        raise SceneError(f"image {path} is missing (named by {source}); add it or remove the view")


def _check_size(path: Path, width: int, height: int, source: str) -> None:
    if width * height > MAX_PIXELS:
        raise SceneError(
            f"{path.name}: {width}x{height} pixels exceed the limit of {MAX_PIXELS} in one image; reduce it (named by "
            f"{source})"
        )
