"""The choice of the device that a run computes on."""

from __future__ import annotations

from enum import StrEnum

import torch

from mgsr.errors import ConfigError, GpuError
from mgsr.native.cuda.launcher import cuda_launcher
from mgsr.pipeline.allocator import prefer_expandable_segments


class Device(StrEnum):
    """The device of a run.

    auto: a card where there is a usable one, else the processor.
    """

    AUTO = "auto"
    CPU = "cpu"
    CUDA = "cuda"

    @property
    def torch(self) -> torch.device:
        """Return the device for tensors.

        Of several cards it is torch's current one (CUDA_VISIBLE_DEVICES chooses among them).
        """
        return torch.device(self.value)


def pick_device(name: str) -> Device:
    """Return the device to use, cpu or cuda, and prepare torch's allocator for a card.

    Raises ConfigError for an unknown name, and where cuda is asked for and torch sees no card; GpuError for a card that
    can't be used (auto falls back to the processor then).
    """
    if name not in tuple(Device):
        raise ConfigError(f"device {name!r}: expected one of {', '.join(Device)}")
    if name == Device.CPU:
        return Device.CPU
    if not torch.cuda.is_available():
        if name == Device.AUTO:
            return Device.CPU
        built = "is built for the CPU alone" if torch.version.cuda is None else "sees no NVIDIA card or driver"
        raise ConfigError(f"device cuda: this torch {built}; install torch for CUDA, or use the device cpu or auto")
    try:
        launcher = cuda_launcher(torch.cuda.current_device())
    except GpuError:
        if name == Device.CUDA:
            raise
        return Device.CPU
    prefer_expandable_segments(launcher)
    return Device.CUDA
