"""Which device a run computes on."""

from __future__ import annotations

from enum import StrEnum

from mgsr.errors import ConfigError


class Device(StrEnum):
    """auto: the best that this version can use."""

    AUTO = "auto"
    CPU = "cpu"
    CUDA = "cuda"


def pick_device(name: str) -> Device:
    """The device to use. Raises ConfigError for an unknown name, and for cuda, which this version can't use."""
    if name not in tuple(Device):
        raise ConfigError(f"--device {name}: expected one of {', '.join(Device)}")
    if name == Device.CUDA:
        raise ConfigError("--device cuda: this version has no CUDA kernels; use --device cpu or auto")
    return Device.CPU
