"""A photograph with the images that are derived from it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mgsr.config.expert import ObservationOptions
from mgsr.data.camera import Camera
from mgsr.data.images import srgb_to_linear
from mgsr.data.scene import View
from mgsr.data.valid_mask import valid_inside


@dataclass(frozen=True, eq=False)
class Photograph:
    """A view with the images derived from it, each computed at its first use and cached.

    A scene keeps its views for a whole run. Photographs exist only for a part of a run, and their cached images with
    them.
    """

    view: View
    min_alpha: float = ObservationOptions().min_alpha  # these two: see ObservationOptions
    clipped: float = ObservationOptions().clipped

    @property
    def camera(self) -> Camera:
        """Return the view's camera."""
        return self.view.camera

    @cached_property
    def brightness(self) -> np.ndarray:
        """Return the mean of the channels in linear light, [H,W] float32, 0 at invalid pixels."""
        linear = srgb_to_linear(self.view.image.astype(np.float32) / 255).mean(axis=-1)
        return linear if self.view.valid_mask is None else np.where(self.view.valid_mask, linear, 0)

    @cached_property
    def opaque(self) -> np.ndarray:
        """Return the valid pixels that show the object alone and are not clipped, [H,W] bool."""
        view = self.view
        opaque: np.ndarray = view.image.max(axis=-1) <= self.clipped * 255
        if (clipped := view.clipped) is not None:
            opaque &= ~clipped.any(axis=-1)
        if view.alpha is not None:
            opaque &= view.alpha >= self.min_alpha * 255
        if view.valid_mask is not None:
            opaque &= view.valid_mask
        return opaque

    @cached_property
    def interior(self) -> np.ndarray | None:
        """Return the pixels that are valid together with their neighbours, [H,W] bool; None if all are valid.

        Interpolation there reads no invalid pixel.
        """
        return None if self.view.valid_mask is None else valid_inside(self.view.valid_mask, 1)

    @property
    def usable(self) -> np.ndarray:
        """Return the pixels whose brightness is that of the object, also when it is interpolated, [H,W] bool."""
        return self.opaque if self.interior is None else self.opaque & self.interior
