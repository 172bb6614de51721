"""Images: decoding to 8-bit sRGB, reduction by area, compositing."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mgsr.errors import SceneError, in_short

# No camera has more pixels in one picture; files that claim more would fill the memory.
MAX_PIXELS = 1 << 28

_HEIF = (".heic", ".heif")
_HEIF_ERRORS = (ValueError, EOFError, SyntaxError, OSError, RuntimeError, IndexError)  # what pillow-heif raises


@dataclass(frozen=True)
class Picture:
    """A decoded file: colors [H,W,3] uint8 sRGB, straight; alpha [H,W] uint8 or None; orientation: EXIF's number from 1
    to 8, which says how the stored pixels have to be turned to stand upright."""

    colors: np.ndarray
    alpha: np.ndarray | None
    orientation: int = 1


def image_size(path: Path, source: str) -> tuple[int, int]:
    """Width and height, as stored, from the file's header. Raises SceneError for files that can't be read or are
    larger than MAX_PIXELS; `source` names the file that asks for the image."""
    if path.suffix.lower() in _HEIF:
        width, height = _open_heif(path, source).size
        return width, height
    handle = _open(path, source)
    spec = handle.spec()
    handle.close()
    return spec.width, spec.height


def read_image(path: Path, source: str) -> tuple[np.ndarray, np.ndarray | None]:
    """The colours and alpha of `read_picture`."""
    picture = read_picture(path, source)
    return picture.colors, picture.alpha


def read_picture(path: Path, source: str) -> Picture:
    """The file's pixels as they are stored, not yet turned by their EXIF orientation.

    Grey images become RGB, and CMYK too. Files that say they are linear, and float images that say nothing (EXR, HDR),
    get the sRGB curve; all others are taken as sRGB, whatever their depth. Raises SceneError naming the file.
    """
    if path.suffix.lower() in _HEIF:
        return _read_heif(path, source)
    pixels, orientation = _read_pixels(path, source)
    count = pixels.shape[2]
    alpha = np.ascontiguousarray(pixels[..., -1]) if count in (2, 4) else None
    colors = pixels[..., :3] if count >= 3 else np.repeat(pixels[..., :1], 3, axis=2)
    return Picture(np.ascontiguousarray(colors), alpha, orientation)


def upright(pixels: np.ndarray, orientation: int) -> np.ndarray:
    """Stored pixels [H,W,...] turned and mirrored as EXIF's orientation says (Exif 2.32, "Orientation")."""
    if orientation in (5, 6, 7, 8):
        pixels = pixels.swapaxes(0, 1)
    if orientation in (3, 4, 7, 8):
        pixels = pixels[::-1]
    if orientation in (2, 3, 6, 7):
        pixels = pixels[:, ::-1]
    return np.ascontiguousarray(pixels)


def read_mask(path: Path, source: str) -> np.ndarray:
    """A mask [H,W] uint8, 255 on the object: the alpha channel if it says something, else the brightness.

    Masks with the values 0 and 1 are spread to 0 and 255.
    """
    colors, alpha = read_image(path, source)
    mask = alpha if alpha is not None and alpha.min() < 255 else colors.max(axis=2)
    return mask * np.uint8(255) if mask.max() == 1 else mask


def reduce_area(image: np.ndarray, width: int, height: int) -> np.ndarray:
    """The image [H,W,C] at a smaller size, float32: each pixel is the exact mean over the area that it covers."""
    import cv2  # late: training needs no OpenCV

    pixels = np.ascontiguousarray(image, np.float32)
    reduced = cv2.resize(pixels, (width, height), interpolation=cv2.INTER_AREA)
    return reduced.reshape(height, width, image.shape[2])


def composite_on_white(colors: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Colours [H,W,3] uint8 over white, by alpha [H,W] uint8."""
    opacity = alpha[..., None].astype(np.float32) / 255
    return to_uint8(colors * opacity + 255 * (1 - opacity))


def to_uint8(values: np.ndarray) -> np.ndarray:
    """Values in 0..255, rounded and clipped."""
    rounded = np.rint(values)
    return np.clip(rounded, 0, 255, out=rounded).astype(np.uint8)


def srgb_to_linear(colors: np.ndarray) -> np.ndarray:
    """sRGB values 0..1 as linear light (IEC 61966-2-1)."""
    return np.where(colors <= 0.04045, colors / 12.92, ((colors + 0.055) / 1.055) ** 2.4)


def srgb_rate(colors: np.ndarray) -> np.ndarray:
    """How fast sRGB values, where they are these, rise with linear light."""
    return np.where(colors <= 0.04045, 12.92, 1.055 / 2.4 * ((colors + 0.055) / 1.055) ** -1.4)


def linear_to_srgb(light: np.ndarray) -> np.ndarray:
    """Linear light 0..1 as sRGB values (IEC 61966-2-1)."""
    return np.where(light <= 0.0031308, light * 12.92, 1.055 * np.power(light, 1 / 2.4) - 0.055)


def _encode_srgb(linear: np.ndarray) -> np.ndarray:
    """8-bit sRGB from linear light; alpha (the last of 2 or 4 channels) is left linear."""
    light = np.clip(np.nan_to_num(linear), 0, 1)
    curve = linear_to_srgb(light)
    if linear.shape[2] in (2, 4):
        curve[..., -1] = light[..., -1]
    return to_uint8(curve * 255)


def _read_pixels(path: Path, source: str) -> tuple[np.ndarray, int]:
    """All channels [H,W,1..4] uint8, and EXIF's orientation."""
    handle = _open(path, source)
    spec = handle.spec()
    is_linear = _is_linear(spec)
    pixels = handle.read_image(0, 0, 0, spec.nchannels, "float" if is_linear else "uint8")
    trouble = handle.geterror()
    handle.close()
    if pixels is None or trouble:
        raise SceneError(
            f"{path.name}: damaged image: {in_short(trouble) or 'no pixels'} (asked for by {source}); copy it again"
        )
    pixels = pixels.reshape(spec.height, spec.width, spec.nchannels)[..., :4]
    orientation = spec.getattribute("Orientation")
    return _encode_srgb(pixels) if is_linear else pixels, orientation if orientation in range(1, 9) else 1


def _is_linear(spec: Any) -> bool:
    space = spec.getattribute("oiio:ColorSpace")
    if space is None:
        return str(spec.format) in ("half", "float", "double")
    return str(space).lower().startswith("lin")


def _open(path: Path, source: str) -> Any:
    # Late, so that what has its images already (a training run on another machine) needs no OpenImageIO.
    import OpenImageIO

    _check_there(path, source)
    config = OpenImageIO.ImageSpec()
    config.attribute("oiio:UnassociatedAlpha", 1)  # else colours come multiplied by alpha
    handle = OpenImageIO.ImageInput.open(str(path), config)
    if handle is None:
        reason = in_short(OpenImageIO.geterror()) or "unknown type"
        raise SceneError(f"{path.name}: not an image that can be read: {reason} (asked for by {source}); copy it again")
    spec = handle.spec()
    _check_size(path, spec.width, spec.height, source)
    return handle


def _open_heif(path: Path, source: str) -> Any:
    import pillow_heif  # late: few captures need it

    _check_there(path, source)
    try:
        opened = pillow_heif.open_heif(path, convert_hdr_to_8bit=True)
        width, height = opened.size
    except _HEIF_ERRORS as error:
        raise SceneError(
            f"{path.name}: not an image that can be read: {in_short(error)} (asked for by {source}); copy it again"
        ) from error
    _check_size(path, width, height, source)
    return opened


def _read_heif(path: Path, source: str) -> Picture:
    """HEIC turns its own pixels upright when it is decoded, so that nothing is left to turn."""
    opened = _open_heif(path, source)
    try:
        pixels = np.asarray(opened)
    except _HEIF_ERRORS as error:
        reason = in_short(error)
        raise SceneError(f"{path.name}: damaged image: {reason} (asked for by {source}); copy it again") from error
    pixels = pixels.reshape(*pixels.shape[:2], -1)
    colors = np.repeat(pixels[..., :1], 3, axis=2) if pixels.shape[2] < 3 else pixels[..., :3]
    alpha = np.ascontiguousarray(pixels[..., 3]) if pixels.shape[2] == 4 else None
    return Picture(np.ascontiguousarray(colors), alpha)


def _check_there(path: Path, source: str) -> None:
    if not path.is_file():
        raise SceneError(f"image {path} is missing (asked for by {source}); put it there or remove the view")


def _check_size(path: Path, width: int, height: int, source: str) -> None:
    if width * height > MAX_PIXELS:
        raise SceneError(
            f"{path.name}: {width}x{height} pixels; at most {MAX_PIXELS} in one image are taken: reduce it "
            f"(asked for by {source})"
        )
