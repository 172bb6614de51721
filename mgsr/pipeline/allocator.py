"""The way in which torch takes a card's memory from the driver."""

from __future__ import annotations

import os
import platform
import sys

import torch

from mgsr.native.cuda.launcher import CudaLauncher

# Each sets the allocator by itself; torch reads the first two in turn.
OF_USER = ("PYTORCH_CUDA_ALLOC_CONF", "PYTORCH_ALLOC_CONF", "PYTORCH_NO_CUDA_MEMORY_CACHING")
EXPANDABLE = "expandable_segments:True"


def prefer_expandable_segments(launcher: CudaLauncher) -> None:
    """Let torch's allocator extend the memory that it holds instead of adding pieces to it.

    The splats' tensors change their sizes at each densification, so that no later one fits exactly into the pieces that
    earlier ones leave. Nothing is done where the user has set the allocator, and where the card or the system can't map
    memory piece by piece. Call it before the first tensor on the card: what lies there already keeps its piece.
    """
    if any(name in os.environ for name in OF_USER) or _under_windows() or not launcher.maps_memory():
        return
    _set_allocator(EXPANDABLE)


def _under_windows() -> bool:
    """Return whether the driver is that of Windows, also below WSL."""
    return sys.platform == "win32" or "microsoft" in platform.release().lower()


def _set_allocator(settings: str) -> None:
    # Torch has no public call for this; its variables would have to be set before it is imported.
    if hasattr(torch._C, "_accelerator_setAllocatorSettings"):
        torch._C._accelerator_setAllocatorSettings(settings)
    else:  # an older torch
        torch.cuda.memory._set_allocator_settings(settings)
