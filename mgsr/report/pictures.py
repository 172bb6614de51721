"""The pictures of a report, and the conversion of arrays to such pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from mgsr.data.camera import Camera

# The colours of depth and distance, from small to large. They go from light to dark, so they also work without colour.
RAMP = np.array(
    [[252, 246, 219], [250, 214, 134], [245, 163, 78], [224, 101, 65], [176, 50, 80], [110, 25, 92], [44, 12, 66]],
    np.float32,
)


@dataclass(frozen=True)
class TestViewPictures:
    """The pictures of one test view.

    Each is uint8 [H,W,3] or, with straight alpha, [H,W,4], or None if the method has no such picture.

    reflected: weight x reflected over black; added to transmitted, it gives render. unlit: the transmitted light under
    even light, without the flash. whole: the render of a found object in front of its background.
    """

    name: str
    photo: np.ndarray
    render: np.ndarray
    transmitted: np.ndarray | None = None
    reflected: np.ndarray | None = None
    normal: np.ndarray | None = None
    depth: np.ndarray | None = None
    mesh: np.ndarray | None = None
    psnr: float | None = None
    unlit: np.ndarray | None = None
    whole: np.ndarray | None = None

    # Tells pytest that the class is not a test case, although its name begins with "Test".
    __test__ = False


@dataclass(frozen=True)
class Picture:
    """A picture, uint8 [H,W,3] or [H,W,4], and its caption."""

    caption: str
    pixels: np.ndarray


@dataclass(frozen=True)
class SurfacePictures:
    """The pictures of the surface from several sides.

    They show it shaded, in its own colours, and coloured by the distance to the truth. The colour scale ends at `limit`
    times the truth's bounding radius. Empty lists where there is nothing to show.
    """

    shaded: list[Picture] = field(default_factory=list)
    colored: list[Picture] = field(default_factory=list)
    distance: list[Picture] = field(default_factory=list)
    limit: float = 0.01


@dataclass(frozen=True)
class ReportPictures:
    """All pictures of a report; the first view is the one at the top.

    environment_maps: the learned maps that the surface reflects, if any. masks: photographs that are dimmed outside the
    found object's mask, if any. relit: the textured model in a studio that turns around it.
    """

    views: Sequence[TestViewPictures] = ()
    environment_maps: Sequence[Picture] = ()
    surface: SurfacePictures = field(default_factory=SurfacePictures)
    masks: Sequence[Picture] = ()
    relit: Sequence[Picture] = ()


def mask_picture(image: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Return a copy of an image [H,W,3] uint8 that is dimmed and grey outside a mask `alpha` [H,W] uint8."""
    inside = alpha[..., None] / 255.0
    grey = 0.35 * image.mean(axis=-1, keepdims=True)
    return np.asarray((inside * image + (1 - inside) * grey).round().astype(np.uint8))


def color_picture(color: np.ndarray, alpha: np.ndarray | None = None) -> np.ndarray:
    """Convert color [H,W,3] 0..1 to uint8 [H,W,3], or with straight alpha [H,W] 0..1 to uint8 [H,W,4]."""
    channels = color if alpha is None else np.concatenate([color, alpha[..., None]], axis=-1)
    rounded: np.ndarray = np.clip(np.rint(np.nan_to_num(channels) * 255), 0, 255).astype(np.uint8)
    return rounded


def premultiplied_picture(color: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Convert color [H,W,3], premultiplied by alpha [H,W] 0..1, to uint8 [H,W,4] with straight alpha."""
    return color_picture(np.clip(color / np.maximum(alpha, 1e-6)[..., None], 0, 1), np.clip(alpha, 0, 1))


def normal_picture(normal: np.ndarray, camera: Camera, alpha: np.ndarray) -> np.ndarray:
    """Convert world normals, normal [H,W,3] and alpha [H,W], to colours uint8 [H,W,4] in the camera's frame.

    Red is right, green up, blue towards the camera.
    """
    local = normal @ camera.cam_from_world[:3, :3].T * (1, -1, -1)
    length = np.linalg.norm(local, axis=-1, keepdims=True)
    return color_picture(local / np.maximum(length, 1e-6) * 0.5 + 0.5, np.clip(alpha, 0, 1))


def depth_picture(depth: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Convert depth [H,W] and alpha [H,W] to grey uint8 [H,W,4]: near is light, far is dark, and 0 is nothing.

    The range is that between the depths' 1st and 99th percentile.
    """
    seen = (depth > 0) & (alpha > 0.5)
    if not seen.any():
        return np.zeros((*depth.shape, 4), np.uint8)
    low, high = np.percentile(depth[seen], (1, 99))
    shade = ramp((depth - low) / max(high - low, 1e-9))
    return color_picture(shade, np.where(depth > 0, np.clip(alpha, 0, 1), 0))


def ramp(values: np.ndarray) -> np.ndarray:
    """Return the colours [...,3] 0..1 of values [...], clipped to 0..1."""
    place = np.clip(np.nan_to_num(values), 0, 1) * (len(RAMP) - 1)
    low = np.minimum(place.astype(int), len(RAMP) - 2)
    part = (place - low)[..., None]
    colors: np.ndarray = (RAMP[low] * (1 - part) + RAMP[low + 1] * part) / 255
    return colors
