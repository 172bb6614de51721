"""Options of the step `pull_into_hull`."""

from __future__ import annotations

from dataclasses import dataclass

from mgsr.config.options import Options, WholeNumber


@dataclass(frozen=True)
class PullIntoHullOptions(Options):
    """The pull of vertices into the silhouettes."""

    rounds: WholeNumber = 3  # rounds of moving vertices along their normals
