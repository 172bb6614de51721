"""The findings of an inspection: records with a code, a severity, an amount, the photographs and the remedy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any

import numpy as np

_NAMED = 3  # photographs that a line names


class Severity(StrEnum):
    """The severity of a finding.

    error: the result would be wrong. warning: the result loses accuracy or lacks a part. note: for information.
    """

    ERROR = "error"
    WARNING = "warning"
    NOTE = "note"


class Code(StrEnum):
    """The kinds of findings. Programs may rely on these names."""

    BLURRED = "blurred"
    EXPOSURE_JUMPS = "exposure_jumps"
    WRONG_POSES = "wrong_poses"
    DOUBLED_STRUCTURE = "doubled_structure"
    CONTRADICTORY_POSE = "contradictory_pose"
    INACCURATE_POSE = "inaccurate_pose"
    INACCURATE_POSES = "inaccurate_poses"
    SEPARATE_GROUPS = "separate_groups"
    SIMILAR_PLACES = "similar_places"
    MOVING_BACKGROUND = "moving_background"
    UNSEEN_SIDE = "unseen_side"
    LITTLE_PARALLAX = "little_parallax"
    FEW_PHOTOGRAPHS = "few_photographs"
    SMALL_OBJECT = "small_object"
    CUT_OFF = "cut_off"
    CONTRADICTORY_MASK = "contradictory_mask"
    INEXACT_MASKS = "inexact_masks"
    MIXED_LENSES = "mixed_lenses"
    WIDE_LENS = "wide_lens"
    SMALL_IMAGES = "small_images"


@dataclass(frozen=True)
class Finding:
    """One finding.

    text: the description, a sentence without a full stop.
    amount, unit: the size of the problem ("px", "sr", "deg", "share", "times", "photographs").
    cure: the remedy.
    photographs: the names of the affected photographs, empty if all are affected.
    places: camera positions [3] in the user's frame, from which photographs are missing.
    """

    code: Code
    severity: Severity
    text: str
    amount: float
    unit: str
    cure: str
    photographs: tuple[str, ...] = ()
    places: tuple[tuple[float, float, float], ...] = ()

    @property
    def line(self) -> str:
        """Return the finding in one line."""
        named = f" ({shown(self.photographs)})" if self.photographs else ""
        return f"{self.severity}: {self.text}{named}; {self.cure}"


@dataclass(frozen=True)
class InspectedPhoto:
    """The results of the inspection for one photograph.

    center, direction, up: the camera's position, its view direction and the direction of the image's upper side, in the
    user's frame.
    angles: the horizontal and the vertical field of view, in degrees.
    residual: the median distance of matches from the epipolar lines of the cameras, in pixels of the photograph; None
    if too few features match.
    reprojection: the median reprojection error of points that three or more photographs share, in pixels of the
    photograph; None if too few features match.
    """

    name: str
    center: tuple[float, float, float]
    direction: tuple[float, float, float]
    up: tuple[float, float, float]
    angles: tuple[float, float]
    residual: float | None
    reprojection: float | None


@dataclass(frozen=True)
class Inspection:
    """The findings, the worst first, and the inspected photographs. seconds: duration of the inspection."""

    findings: tuple[Finding, ...]
    photographs: tuple[InspectedPhoto, ...]
    seconds: float

    @property
    def worst(self) -> Severity | None:
        """Return the severity of the worst finding; None without findings."""
        return self.findings[0].severity if self.findings else None

    @property
    def contradictory(self) -> tuple[str, ...]:
        """Return the names of the photographs whose poses contradict the others or are much less exact."""
        poses = (Code.DOUBLED_STRUCTURE, Code.CONTRADICTORY_POSE, Code.INACCURATE_POSE)
        return tuple(name for finding in self.findings if finding.code in poses for name in finding.photographs)

    def to_json(self) -> dict[str, Any]:
        """Return the inspection as plain types. It lacks the seconds, so the same photographs give the same result."""
        plain: dict[str, Any] = asdict(self)
        del plain["seconds"]
        return plain


def sorted_by_severity(findings: Sequence[Finding]) -> tuple[Finding, ...]:
    """Return the findings with the worst first."""
    order = list(Severity)
    return tuple(sorted(findings, key=lambda finding: order.index(finding.severity)))


def shown(names: Sequence[str]) -> str:
    """Return the first few of the names, as a list in words."""
    return ", ".join(names[:_NAMED]) + (", ..." if len(names) > _NAMED else "")


def pick(names: Sequence[str], indices: np.ndarray) -> tuple[str, ...]:
    """Return the names at indices [K]."""
    return tuple(names[int(index)] for index in indices)
