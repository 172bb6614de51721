"""Rendered views as image files.

Each view has these files. Alpha is straight.

- `<name>.png`: the colour, 8-bit RGBA.
- `<name>_transmitted.png`: the transmitted colour, 8-bit RGBA.
- `<name>_even.png`: the transmitted colour under even light, 8-bit RGBA, if a flash is known.
- `<name>_whole.png`: the object before its background, 8-bit RGB, if an object was found.
- `<name>_reflected.png`: the reflected colour, 8-bit RGB.
- `<name>_weight.png`: the reflection weight, 8-bit grey, 255 is 1.
- `<name>_depth.png`: 16-bit grey, 0 without surface. Its value times the number in the file's text field `depth_scale`
  is camera z in the user's unit.
- `<name>_normal.png`: the world normal n as 255 (n + 1) / 2, 8-bit RGBA.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mgsr.data.backdrop import Color
from mgsr.errors import MgsrError, SceneError


@dataclass(frozen=True)
class Rendering:
    """The images of one camera, float; each pixel is sampled at its centre.

    color [H,W,3] sRGB 0..1, straight (not multiplied by alpha). alpha [H,W] 0..1. depth [H,W] camera z in the user's
    unit, 0 where nothing is. normal [H,W,3] in the capture's axes and towards the camera, zeros where nothing is.

    With a light split, color is transmitted + weight * reflected, then divided by alpha. transmitted [H,W,3], straight,
    has no gloss; reflected [H,W,3] is sRGB, weight [H,W] 0..1. All three are None without a light split.
    unlit [H,W,3]: the transmitted colour, or the only one, under even light; None where no flash is known. With a
    flash, the other colours show the scene under a flash on this camera. whole [H,W,3]: sRGB, the object before its
    background; None where no object was found.
    """

    color: np.ndarray
    alpha: np.ndarray
    depth: np.ndarray
    normal: np.ndarray
    transmitted: np.ndarray | None = None
    reflected: np.ndarray | None = None
    weight: np.ndarray | None = None
    unlit: np.ndarray | None = None
    whole: np.ndarray | None = None


def straight_color(on_black: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Return the straight colour [H,W,3] of an image `on_black` [H,W,3], rendered on black with alpha [H,W] 0..1.

    It is black where alpha rounds to nothing.
    """
    visible = alpha[..., None] >= 0.5 / 255
    return np.where(visible, np.clip(on_black / np.maximum(alpha[..., None], 1e-6), 0, 1), 0)


def on_background(on_black: np.ndarray, alpha: np.ndarray, background: Color) -> np.ndarray:
    """Composite an image `on_black` [H,W,3], rendered on black with alpha [H,W] 0..1, on a colour."""
    composited: np.ndarray = np.clip(on_black + (1 - alpha[..., None]) * np.array(background), 0, 1)
    return composited


def write_view(folder: Path, name: str, view: Rendering) -> list[Path]:
    """Write a view's images, except those that are None, as the module says, and return their paths.

    view: its depth is in the files' unit; its normals may have any length. name: the view's, without extension; its
    folders are made. Raises SceneError for a name that leads outside.
    """
    images: dict[str, np.ndarray] = {"": _rgba(view.color, view.alpha)}
    for suffix, color in (("_transmitted", view.transmitted), ("_even", view.unlit)):
        if color is not None:
            images[suffix] = _rgba(color, view.alpha)
    if view.whole is not None:
        images["_whole"] = _bytes(view.whole)
    if view.reflected is not None:
        images["_reflected"] = _bytes(view.reflected)
    if view.weight is not None:
        images["_weight"] = _bytes(view.weight[..., None])
    scale = float(view.depth.max()) / 65535 or 1.0
    images["_depth"] = np.rint(view.depth / scale).astype(np.uint16)[..., None]
    lengths = np.linalg.norm(view.normal, axis=-1, keepdims=True)
    images["_normal"] = _rgba((view.normal / np.maximum(lengths, 1e-9) + 1) / 2, view.alpha)
    return [
        _write(_path(folder, name + suffix), image, repr(scale) if suffix == "_depth" else None)
        for suffix, image in images.items()
    ]


def _path(folder: Path, name: str) -> Path:
    path = folder / f"{name}.png"
    if not path.resolve().is_relative_to(folder.resolve()):
        raise SceneError(f"view name {name!r}: expected a name inside {folder}; rename the image")
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


def _rgba(color: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Return a picture [H,W,4] uint8 of a colour [H,W,3] and an alpha [H,W], both 0..1."""
    return np.concatenate([_bytes(color), _bytes(alpha[..., None])], axis=-1)


def _bytes(image: np.ndarray) -> np.ndarray:
    """Return an image [H,W,C] of 0..1 as uint8; NaN becomes 0."""
    rounded: np.ndarray = np.rint(np.clip(np.nan_to_num(image), 0, 1) * 255).astype(np.uint8)
    return rounded


def _write(path: Path, image: np.ndarray, depth_scale: str | None) -> Path:
    """Write an image [H,W,C] uint8 or uint16 as PNG, with the unit of a depth map; return its path."""
    # A late import: computing renders needs no OpenImageIO.
    import OpenImageIO

    height, width, channels = image.shape
    spec = OpenImageIO.ImageSpec(width, height, channels, "uint16" if image.dtype == np.uint16 else "uint8")
    if channels == 4:
        spec.attribute("oiio:UnassociatedAlpha", 1)  # the colours are straight already: leave them alone
    if depth_scale is not None:
        spec.attribute("depth_scale", depth_scale)
    output = OpenImageIO.ImageOutput.create(str(path))
    if output is None or not output.open(str(path), spec) or not output.write_image(np.ascontiguousarray(image)):
        raise MgsrError(
            f"{path}: the file cannot be written: {output.geterror() if output else OpenImageIO.geterror()}"
        )
    output.close()
    return path
