"""How a capture is read."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated

import numpy as np

from mgsr.config.options import Pattern
from mgsr.errors import ConfigError

_NUMBER = r"\s*[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?\s*"


class Masks(StrEnum):
    """What the masks of photographs mean.

    auto: MGSR finds out, and uses silhouettes if every view has one. object: white is the object, and every view
    needs a mask. ignore: black is left out, such as passers-by. off: masks are not used, and images with alpha are
    put on white.
    """

    AUTO = "auto"
    OBJECT = "object"
    IGNORE = "ignore"
    OFF = "off"


class Flawed(StrEnum):
    """How blurred photographs and contradictory poses are treated.

    keep: all photographs are used. drop: photographs much less sharp than their neighbours are left out, and so are
    those whose poses contradict what they show.
    """

    KEEP = "keep"
    DROP = "drop"


class Object(StrEnum):
    """What is reconstructed from a capture without masks.

    auto: the single object in the middle, if MGSR finds one; otherwise everything in view. off: everything in view.
    """

    AUTO = "auto"
    OFF = "off"


class Exposure(StrEnum):
    """How differing exposures are treated.

    auto: photographs are brought to a common exposure. keep: they stay as they are.
    """

    AUTO = "auto"
    KEEP = "keep"


@dataclass(frozen=True)
class DataConfig:
    """How a capture is read."""

    masks: Masks = Masks.AUTO
    exposure: Exposure = Exposure.AUTO
    adjust_cameras: bool = True  # Without masks, the cameras are moved to where the photographs agree.
    object: Object = Object.AUTO
    # Two opposite corners x0,y0,z0,x1,y1,z1 of a box around the object, in the capture's frame and unit. MGSR finds
    # masks of what lies in the box. none: `object` decides.
    object_box: Annotated[str | None, Pattern(f"({_NUMBER},){{5}}{_NUMBER}", "-1,-1,0,1,1,2")] = None
    flawed: Flawed = Flawed.KEEP
    check: bool = True  # Photographs, cameras and masks are inspected before training, as by `mgsr check`.
    confined: bool = False  # Files outside the given folder are not read. The service sets this for every job.
    # Each photograph has a lens of its own when cameras are searched for, as after zooming or cropping. off: the
    # photographs of one camera share a lens.
    camera_per_image: bool = False
    video_frames: int = 200  # The most frames of a video that are used. The motion decides their number.
    test_every: int = 8  # Every n-th view is held out, unless the capture names a split.
    # Larger photographs are reduced to this many pixels on the longer side, by area averaging before undistortion.
    max_side: int = 1600


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
