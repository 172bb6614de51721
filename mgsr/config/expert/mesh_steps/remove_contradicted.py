"""Options of the step `remove_contradicted`."""

from __future__ import annotations

from dataclasses import dataclass

from mgsr.config.options import NotNegative, Options, Share


@dataclass(frozen=True)
class RemoveContradictedOptions(Options):
    """The removal of patches with a large photometric residual under a flash."""

    share: Share = 0.5  # share of the largest residual above which a face belongs to a patch
    min_pixels: NotNegative = 10.0  # least pixels that a removed patch covers
