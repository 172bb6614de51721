"""The choice of a run's device, and the settings of torch's memory allocator on a GPU."""

from __future__ import annotations

import os
import platform
import sys
from enum import StrEnum

import torch

from mgsr.errors import ConfigError, GpuError
from mgsr.native.cuda.launcher import CudaLauncher, cuda_launcher

# Variables by which users configure the allocator. Torch reads the first that is set of the first two.
OF_USER = ("PYTORCH_CUDA_ALLOC_CONF", "PYTORCH_ALLOC_CONF", "PYTORCH_NO_CUDA_MEMORY_CACHING")
EXPANDABLE = "expandable_segments:True"


class Device(StrEnum):
    """The device of a run.

    auto: a usable GPU, else the CPU.
    """

    AUTO = "auto"
    CPU = "cpu"
    CUDA = "cuda"

    @property
    def torch(self) -> torch.device:
        """Return the device for tensors.

        Of several GPUs it is torch's current one (CUDA_VISIBLE_DEVICES chooses among them).
        """
        return torch.device(self.value)


def pick_device(name: str) -> Device:
    """Return the device to use, cpu or cuda, and prepare torch's allocator for a GPU.

    Raises ConfigError for an unknown name, and for cuda if torch sees no GPU. Raises GpuError for a GPU that can't
    be used; auto then falls back to the CPU.
    """
    if name not in tuple(Device):
        raise ConfigError(f"device {name!r}: expected one of {', '.join(Device)}")
    if name == Device.CPU:
        return Device.CPU
    if not torch.cuda.is_available():
        if name == Device.AUTO:
            return Device.CPU
        built = "is built for the CPU only" if torch.version.cuda is None else "sees no NVIDIA GPU or driver"
        raise ConfigError(
            f"device cuda: the installed torch {built}; install torch for CUDA, or use the device cpu or auto"
        )
    try:
        launcher = cuda_launcher(torch.cuda.current_device())
    except GpuError:
        if name == Device.CUDA:
            raise
        return Device.CPU
    prefer_expandable_segments(launcher)
    return Device.CUDA


def prefer_expandable_segments(launcher: CudaLauncher) -> None:
    """Let torch's allocator extend the memory that it holds instead of adding pieces to it.

    Each densification changes the sizes of the splats' tensors, so a new tensor does not fit the freed blocks of
    earlier ones. The function does nothing where the user has set the allocator, or where the GPU or the system does
    not support expandable segments. Call it before the first tensor on the GPU; existing tensors keep their blocks.
    """
    if any(name in os.environ for name in OF_USER) or _under_windows() or not launcher.maps_memory():
        return
    _set_allocator(EXPANDABLE)


def _under_windows() -> bool:
    """Return whether the GPU's driver is the Windows driver, as also under WSL."""
    return sys.platform == "win32" or "microsoft" in platform.release().lower()


def _set_allocator(settings: str) -> None:
    # Torch has no public call for this; its variables would have to be set before it is imported.
    if hasattr(torch._C, "_accelerator_setAllocatorSettings"):
        torch._C._accelerator_setAllocatorSettings(settings)
    else:  # an older torch
        torch.cuda.memory._set_allocator_settings(settings)
