"""How a capture is read."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from mgsr.errors import ConfigError


class Masks(StrEnum):
    """What the masks beside photographs mean. auto: found out, and silhouettes are used where every view has one;
    object: white is the object, and every view needs a mask; ignore: black is what to leave out, such as passers-by;
    off: they are not used, and images with alpha are put on white."""

    AUTO = "auto"
    OBJECT = "object"
    IGNORE = "ignore"
    OFF = "off"


class Flawed(StrEnum):
    """keep: photographs that are much less sharp than their neighbours, and those whose poses contradict what they
    show, are used; drop: they are left out."""

    KEEP = "keep"
    DROP = "drop"


class Object(StrEnum):
    """What is reconstructed of a capture without masks. auto: the object that stands in the middle, if there is a
    single one, by masks that are found for it; else all that is seen. off: all that is seen."""

    AUTO = "auto"
    OFF = "off"


class Exposure(StrEnum):
    """auto: photographs whose exposures differ are brought to a common one; keep: they stay as they are."""

    AUTO = "auto"
    KEEP = "keep"


@dataclass(frozen=True)
class DataConfig:
    """How a capture is read."""

    masks: Masks = Masks.AUTO
    exposure: Exposure = Exposure.AUTO
    object: Object = Object.AUTO
    object_box: str | None = None  # x0,y0,z0,x1,y1,z1 in the capture's frame and unit: between these corners lies the
    # object, of which masks are found then; none leaves it to `object`
    flawed: Flawed = Flawed.KEEP
    check: bool = True  # inspect photographs, cameras and masks before training (`mgsr check`)
    confined: bool = False  # look for nothing outside the folder that is given; jobs of the service always do so
    camera_per_image: bool = False  # where cameras are searched for: each photograph has a lens of its own, as after
    # zooming or cropping; else the photographs of one camera share a lens
    video_frames: int = 200  # at most so many frames of videos are used; their number depends on the motion
    test_every: int = 8  # every n-th view is held out, where the files name no split
    max_side: int = 1600  # pixels; larger photographs are reduced to this by area means, before the lens is undone


def object_box(text: str | None) -> np.ndarray | None:
    """Return the corners [2,3] of a box that text names as six numbers, the least corner first; None for None.

    Raises ConfigError for other texts.
    """
    if text is None:
        return None
    try:
        corners = np.array([float(part) for part in text.split(",")]).reshape(2, 3)
    except ValueError:
        corners = np.zeros((2, 3))
    if not (np.isfinite(corners).all() and (corners[0] < corners[1]).all()):
        raise ConfigError(
            f"data.object_box: expected x0,y0,z0,x1,y1,z1 with x0 < x1, y0 < y1 and z0 < z1, got {text!r}"
        )
    return corners
