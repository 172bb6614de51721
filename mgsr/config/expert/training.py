"""Options of what training decides by numbers of its own (`mgsr.densify`, `mgsr.training`)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

from mgsr.config.options import Count, NotNegative, Options, Positive, Range, Share, WholeNumber

Degree = Annotated[int, Range(0, 3)]


@dataclass(frozen=True)
class ErrorGrowthOptions(Options):
    """Error-driven growth of the 3D branch. Source: Baranowski and others 2025 (ConeGS)."""

    solid: Share = 0.3  # alpha from which a rendered depth counts as a surface
    hidden: Positive = 3.0  # distance, in sizes of a pixel, that a point may lie off the rendered surface of a view
    # that sees it
    half_window: WholeNumber = 1  # pixels on each side of a pixel over which the error is averaged, against sensor
    # noise

    @property
    def window(self) -> int:
        """Return the averaging window's side in pixels."""
        return 2 * self.half_window + 1


@dataclass(frozen=True)
class DensifyOptions(Options):
    """Where splats are added and where none may lie."""

    clearance_rank: Count = 10  # rank of the starting point that is nearest to a camera; nearer ones may be outliers
    error_growth: ErrorGrowthOptions = field(default_factory=ErrorGrowthOptions)


@dataclass(frozen=True)
class ProxyModelOptions(Options):
    """A small 3D branch that is trained on small photographs before the real training to learn from it."""

    side: Annotated[int, Range(8)] = 128  # pixels; longer side of the photographs
    points: Count = 4000  # number of Gaussians
    rates: Share = 0.2  # position of the constant learning rates between a warm-up's first and last ones; 0 is the
    # first


@dataclass(frozen=True)
class LearnedMaskOptions(Options):
    """Masks of photographs before a plain backdrop, learned by two proxy models."""

    degree: Degree = 2  # degree of the colours' harmonics
    rough_iterations: Count = 800  # iterations of the first branch
    iterations: Count = 1600  # iterations of the second branch
    rough_side: Annotated[int, Range(8)] = 64  # pixels; longer side of the first branch's photographs
    opacity_cost: NotNegative = 0.4  # weight of the first branch's loss on opacity; half of it leaves fog around shiny
    # objects, and twice as much erodes thin parts
    voxels: Annotated[int, Range(8)] = 64  # voxels along a side of the rough hull's grid
    proxy: ProxyModelOptions = field(default_factory=ProxyModelOptions)


@dataclass(frozen=True)
class ExposureOptions(Options):
    """The estimation of the photographs' exposures by proxy models."""

    degree: Degree = 2  # of the harmonics of the candidate that is not matte; the matte one has none
    iterations: Count = 150  # iterations of each training
    rounds: Count = 3  # rounds, each of which begins with the factors found so far
    held_out: Annotated[int, Range(2)] = 4  # one view in this many is held out from a training
    min_views: Count = 12  # least views for which exposures are estimated
    min_jump: NotNegative = 0.07  # brightness change between neighbours below which exposures count as equal
    jump_views: Count = 48  # views, spread over all, whose neighbours are compared; frames of a video change slowly
    min_gain: NotNegative = 0.5  # dB that factors must gain on the halves of photographs to which they were not fitted
    faint: Share = 0.3  # share of the median light below which pixels are ignored
    min_pixels: Count = 20  # least pixels to which a factor is fitted
    clipped: Annotated[int, Range(1, 256)] = 250  # of 255; brighter pixels hide how bright they were
    white: Positive = 0.9  # rendered light times factor above which the photograph may be clipped
    proxy: ProxyModelOptions = field(default_factory=ProxyModelOptions)


@dataclass(frozen=True)
class BackgroundOptions(Options):
    """The surfels of what lies around a found object."""

    mask_margin: Share = 0.005  # of the photograph's longer side; margin of the masks that training ignores
    inside: Share = 0.9  # of the views; a starting point inside the masks of more views is the object's


@dataclass(frozen=True)
class TrainingOptions(Options):
    """What is trained before the training."""

    background: BackgroundOptions = field(default_factory=BackgroundOptions)
    learned_masks: LearnedMaskOptions = field(default_factory=LearnedMaskOptions)
    exposure: ExposureOptions = field(default_factory=ExposureOptions)
