"""The input of surface extraction: rendered views of the surface, and sampling of their images."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch.nn.functional import grid_sample

from mgsr.data.camera import Camera
from mgsr.errors import MeshError


@dataclass(frozen=True)
class SurfaceView:
    """The surface rendered from one camera, float32, in the scene's frame.

    depth [H,W]: camera z, 0 without surface. normal [H,W,3]: in the world frame, towards the camera, of any length.
    alpha [H,W]: 0..1. color [H,W,3]: sRGB 0..1; the transmitted colour for a mesh without highlights. mask [H,W] bool:
    the pixels that may be used; None: all.

    Raises MeshError if an image's size differs from the camera's.
    """

    camera: Camera
    depth: np.ndarray
    normal: np.ndarray
    alpha: np.ndarray
    color: np.ndarray
    mask: np.ndarray | None = None

    def __post_init__(self) -> None:
        size = (self.camera.height, self.camera.width)
        for name, channels in (("depth", ()), ("normal", (3,)), ("alpha", ()), ("color", (3,)), ("mask", ())):
            image = getattr(self, name)
            if image is not None and image.shape != size + channels:
                raise MeshError(
                    f"{name} of a surface view: expected the camera's shape {[*size, *channels]}, got "
                    f"{list(image.shape)}"
                )

    def usable(self, min_alpha: float) -> np.ndarray:
        """Return the pixels that show a surface, [H,W] bool."""
        valid = (self.alpha >= min_alpha) & (self.depth > 0) & np.isfinite(self.depth)
        usable: np.ndarray = valid if self.mask is None else valid & self.mask
        return usable


def bilinear_cells(pixels: np.ndarray, size: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Find the four pixels of an image of a size (height, width, ...) around `pixels` [P,2] (centres at +0.5).

    Returns the columns and rows [P] of the upper left ones, and the shares [P] float32, 0..1, of the right and of the
    lower ones. Coordinates are clamped at the border.
    """
    height, width = size[:2]
    x = np.clip(pixels[:, 0] - 0.5, 0, width - 1)
    y = np.clip(pixels[:, 1] - 0.5, 0, height - 1)
    left, top = np.minimum(x.astype(np.int64), width - 2), np.minimum(y.astype(np.int64), height - 2)
    return left, top, (x - left).astype(np.float32), (y - top).astype(np.float32)


def sample(image: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Interpolate an image [H,W,C] bilinearly at pixels [P,2] (centres at +0.5), clamped at the border, as float32."""
    height, width = image.shape[:2]
    places = pixels.astype(np.float32) * (2 / np.array([width, height], np.float32)) - 1
    channels = torch.from_numpy(np.ascontiguousarray(image.transpose(2, 0, 1), np.float32))
    values = grid_sample(
        channels[None], torch.from_numpy(places)[None, None], padding_mode="border", align_corners=False
    )
    return values[0, :, 0].T.numpy()


def project(camera: Camera, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Project points [P,3] of the world frame into a camera, and select those in front of it and inside its image.

    Returns their indices [Q], pixel coordinates [Q,2] float32, and camera z [Q] float32.
    """
    pose = camera.cam_from_world.astype(np.float32)
    x, y, depths = pose[:3, :3] @ points.T.astype(np.float32, copy=False) + pose[:3, 3:]
    with np.errstate(divide="ignore", invalid="ignore"):
        columns = x / depths * np.float32(camera.K[0, 0]) + np.float32(camera.K[0, 2])
        rows = y / depths * np.float32(camera.K[1, 1]) + np.float32(camera.K[1, 2])
    inside = (depths > 0) & (columns >= 0) & (rows >= 0) & (columns < camera.width) & (rows < camera.height)
    index = np.flatnonzero(inside)
    return index, np.stack([columns[index], rows[index]], axis=1), depths[index]


def nearest(image: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Return the values [P,...] of an image [H,W,...] at the pixels that contain coordinates [P,2] inside it."""
    columns, rows = pixels.astype(np.int64).T
    values: np.ndarray = image[rows, columns]
    return values
