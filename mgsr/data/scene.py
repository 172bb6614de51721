"""A loaded scene: views with images and cameras, in one normalised frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TypeVar

import numpy as np

from mgsr.config import Background, DataConfig
from mgsr.config.expert import DataOptions
from mgsr.data.backdrop import BLACK, WHITE, Backdrop, Color, plain_backdrop
from mgsr.data.camera import Camera
from mgsr.data.object_place import ObjectPlace

Item = TypeVar("Item")

PHOTOGRAPHS = 64  # views that suffice to examine a surface; more add little


@dataclass(frozen=True)
class View:
    """One photograph with its camera; `Photograph` adds the images that are derived from it.

    name: unique, without extension.
    image [H,W,3]: uint8 sRGB, not premultiplied.
    alpha [H,W]: uint8, 255 on the object; None without a mask.
    valid_mask [H,W] bool: the valid pixels; None if all are valid. Image and alpha are undefined at other pixels (see
    `valid_mask.py`).
    irradiance [H,W] uint8: the irradiance of each pixel's surface by a flash on the camera, as 255 light^(1/2.4) of the
    light relative to its maximum; None if no flash is known.
    white [3] uint8: the least values of the channels that may be clipped, so that the light may have been brighter.
    None unless the photograph was brought to a common exposure; otherwise, all photographs clip at the same light.
    """

    name: str
    camera: Camera
    image: np.ndarray
    alpha: np.ndarray | None = None
    valid_mask: np.ndarray | None = None
    irradiance: np.ndarray | None = None
    white: np.ndarray | None = None

    @property
    def clipped(self) -> np.ndarray | None:
        """Return where a channel may be clipped, [H,W,3] bool; None where `white` is None."""
        return None if self.white is None else self.image >= self.white

    def cropped(self, rows: slice, columns: slice) -> View:
        """Return a part of the view that shares its memory; both slices have a start and a stop inside the image."""

        def part(pixels: np.ndarray | None) -> np.ndarray | None:
            return None if pixels is None else pixels[rows, columns]

        return View(
            self.name,
            self.camera.cropped(rows, columns),
            self.image[rows, columns],
            part(self.alpha),
            part(self.valid_mask),
            part(self.irradiance),
            self.white,
        )


@dataclass(frozen=True)
class Similarity:
    """The map from the normalised frame to the user's: user = scale * scene + offset. Axes keep their directions."""

    scale: float = 1.0
    offset: np.ndarray = field(default_factory=lambda: np.zeros(3))

    def to_user(self, points: np.ndarray) -> np.ndarray:
        """Return points [P,3] of the normalised frame in the user's frame."""
        placed: np.ndarray = points * self.scale + self.offset
        return placed

    def to_scene(self, points: np.ndarray) -> np.ndarray:
        """Return points [P,3] of the user's frame in the normalised frame."""
        placed: np.ndarray = (points - self.offset) / self.scale
        return placed

    def plane_to_user(self, plane: np.ndarray) -> np.ndarray:
        """Return a plane [4], unit normal and offset, of the normalised frame in the user's frame."""
        return np.append(plane[:3], plane[3] * self.scale - plane[:3] @ self.offset)

    @property
    def inverse(self) -> Similarity:
        """Return the inverse similarity: scene = inverse.to_user(user)."""
        return Similarity(1 / self.scale, -self.offset / self.scale)

    def camera_to_user(self, camera: Camera) -> Camera:
        """Return the camera with its pose in the user's frame."""
        pose = camera.cam_from_world.copy()
        pose[:3, 3] = self.scale * pose[:3, 3] - pose[:3, :3] @ self.offset
        return Camera(camera.K, pose, camera.width, camera.height)

    def camera_to_scene(self, camera: Camera) -> Camera:
        """Return the camera of the user's frame with its pose in the normalised frame."""
        pose = camera.cam_from_world.copy()
        pose[:3, 3] = (pose[:3, 3] + pose[:3, :3] @ self.offset) / self.scale
        return Camera(camera.K, pose, camera.width, camera.height)


@dataclass(frozen=True)
class PointCloud:
    """Points [P,3] float64 in the scene's frame and their colours [P,3] uint8 sRGB."""

    positions: np.ndarray
    colors: np.ndarray

    def __len__(self) -> int:
        return len(self.positions)

    def rows(self, kept: np.ndarray) -> PointCloud:
        """Return the points of these indices, or where this [P] bool is true."""
        return PointCloud(self.positions[kept], self.colors[kept])

    def joined(self, other: PointCloud) -> PointCloud:
        """Return these points followed by the other's."""
        positions = np.concatenate([self.positions, other.positions])
        return PointCloud(positions, np.concatenate([self.colors, other.colors]))


@dataclass(frozen=True)
class Exposures:
    """The exposure factors of the photographs, relative to the common exposure.

    Each is a factor of each channel's linear light: of the training views [V,3] and of the test views [T,3].
    """

    train: np.ndarray
    test: np.ndarray

    @property
    def largest_difference(self) -> float:
        """Return the ratio of the brightest exposure to the darkest.

        It compares geometric means over the channels.
        """
        light = np.log(np.concatenate([self.train, self.test])).mean(axis=1)
        return float(np.exp(light.max() - light.min()))


@dataclass(frozen=True)
class Scene:
    """A capture in its normalised frame: the object (or the region that the cameras look at) lies in the unit ball.

    user_from_scene: converts results to the frame and scale of the input files.
    format: the name of the reader.
    root: the folder that was read; for an archive, its unpacked folder.
    notes: messages to the user about omitted input.
    warning: one of the notes, if it says that the surface will be a guess.

    exposures: the factors divided out of the photographs; None if they are unchanged (see `exposure.py`).
    ignoring: whether masks of regions to ignore make pixels invalid.
    source, read_with, options: the path, the settings and the expert options of the reading; None and the defaults for
    a scene that was not read from files.

    ground [4]: the plane on which a found object stands, None if it is unknown. It holds the points x with
    ground[:3] . x + ground[3] = 0; its unit normal points up.
    masks_found: whether the masks are those of a found object.
    mask_error: the median distance, in pixels, of given masks' contours to those of their hull; None until it is
    measured by `with_mask_error`.
    object_place: the object's place according to the capture, None if the capture gives none.
    camera_shift: the median distance, in pixels, by which the adjustment of the cameras moved points in the
    photographs; None if the cameras are those of the capture.
    """

    name: str
    root: Path
    format: str
    train: list[View]
    test: list[View]
    points: PointCloud | None
    user_from_scene: Similarity
    notes: tuple[str, ...] = ()
    exposures: Exposures | None = None
    warning: str | None = None
    ignoring: bool = False
    source: Path | None = None
    read_with: DataConfig = field(default_factory=DataConfig)
    options: DataOptions = field(default_factory=DataOptions)
    ground: np.ndarray | None = None
    masks_found: bool = False
    mask_error: float | None = None
    object_place: ObjectPlace | None = None
    camera_shift: float | None = None

    @property
    def masked(self) -> bool:
        """Return whether every training view has a mask."""
        return all(view.alpha is not None for view in self.train)

    @property
    def masks_inexact(self) -> bool:
        """Return whether the masks err in places and along their contours, as those of a found object do."""
        return self.masks_found or (self.mask_error or 0.0) > self.options.mask_error.exact

    @property
    def mask_dissent(self) -> int:
        """Return the number of training views whose masks may exclude a point of the object; 0 for given masks."""
        return int(self.options.mask_dissent * len(self.train)) if self.masks_found else 0

    @property
    def mask_margin(self) -> float:
        """Return by how many pixels a point of the object may lie outside given masks; 0 if they are exact."""
        return (self.mask_error or 0.0) if self.masks_inexact and not self.masks_found else 0.0

    def with_cameras(self, train: Sequence[Camera], test: Sequence[Camera], shift: float) -> Scene:
        """Return the scene with adjusted cameras of its views. shift: see `camera_shift`."""
        placed_train, placed_test = (
            [replace(view, camera=camera) for view, camera in zip(views, cameras, strict=True)]
            for views, cameras in ((self.train, train), (self.test, test))
        )
        return replace(self, train=placed_train, test=placed_test, camera_shift=shift)

    @cached_property
    def plain_backdrop(self) -> Color | None:
        """Return the colour, sRGB 0..1, of a plain backdrop in the training photographs.

        None without one, and for masked scenes, which need none.
        """
        photographs = [(view.image, view.valid_mask) for view in self.train]
        return None if self.masked else plain_backdrop(photographs, self.options.backdrop)

    @cached_property
    def mean_color(self) -> Color:
        """Return the mean colour of the training photographs' valid pixels, sRGB 0..1; white without a valid pixel."""
        pixels = [
            view.image[::4, ::4][... if view.valid_mask is None else view.valid_mask[::4, ::4]].reshape(-1, 3)
            for view in some_of(self.train)
        ]
        means = [part.mean(axis=0) / 255 for part in pixels if len(part)]
        red, green, blue = np.mean(means, axis=0).tolist() if means else WHITE
        return (red, green, blue)

    def backdrop(self, kind: Background) -> Backdrop:
        """Choose the background behind the splats from the background setting, the masks and the photographs."""
        if kind is Background.RANDOM or (kind is Background.AUTO and self.masked):
            return Backdrop(WHITE, random=True)
        if kind is Background.AUTO and self.plain_backdrop is not None:
            return Backdrop(self.plain_backdrop, plain=True, near=self.options.backdrop.near)
        if kind is Background.AUTO:
            return Backdrop(self.mean_color)
        return Backdrop(BLACK if kind is Background.BLACK else WHITE)


def some_of(items: Sequence[Item], most: int = PHOTOGRAPHS) -> list[Item]:
    """Return at most so many of the items, such as views, spread over all."""
    chosen = np.unique(np.linspace(0, len(items) - 1, most).round().astype(int))
    return [items[index] for index in chosen]
