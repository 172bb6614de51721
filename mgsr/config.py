"""Every setting with its default, unit and meaning. Only the command line, the service and the worker build these."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum


class Masks(StrEnum):
    """auto: use them where every view has one; off: composite on white and forget them; require: fail without."""

    AUTO = "auto"
    OFF = "off"
    REQUIRE = "require"


@dataclass(frozen=True)
class DataConfig:
    """How a capture is read."""

    masks: Masks = Masks.AUTO
    test_every: int = 8  # every n-th view is held out, where the files name no split
    max_side: int = 1600  # pixels; larger images are reduced to this with area filtering


@dataclass(frozen=True)
class MeshConfig:
    """How the surface is taken from the 2D branch."""


@dataclass(frozen=True)
class TrainConfig:
    """How the two branches are trained."""


@dataclass(frozen=True)
class Config:
    """One run."""

    seed: int = 0
    data: DataConfig = field(default_factory=DataConfig)
    train: TrainConfig = field(default_factory=TrainConfig)
    mesh: MeshConfig = field(default_factory=MeshConfig)
