"""Kernel launches, all of which go through a Launcher. On a GPU it is CudaLauncher."""

from __future__ import annotations

import ctypes
import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache
from typing import Any, Protocol

import torch

from mgsr.errors import GpuError, LostGpuError
from mgsr.native.cuda.compiler import INSTALL, arch_for, compile_family

# Driver errors after which a process can't use the GPU any more.
LOST = tuple(
    f"CUDA_ERROR_{name}"
    for name in ("ILLEGAL_ADDRESS", "ILLEGAL_INSTRUCTION", "MISALIGNED_ADDRESS", "LAUNCH_FAILED", "LAUNCH_TIMEOUT")
)

# The kernels' parameters are one structure.
ONE_ADDRESS = ctypes.c_void_p * 1
# Returns the stream's handle; torch.cuda.current_stream wraps it in an object, which takes twenty times as long.
current_stream: Callable[[int], int] = getattr(
    torch._C, "_cuda_getCurrentRawStream", lambda device: torch.cuda.current_stream(device).cuda_stream
)


class Launcher(Protocol):
    """A machine that runs kernels in CUDA C++."""

    def launch(self, family: str, kernel: str, blocks: int, threads: int, params: ctypes.Structure) -> None:
        """Run a kernel of kernels/<family>/<family>.cu on `blocks` blocks of `threads` threads.

        It runs after all earlier launches; `params` is copied. 0 blocks run nothing. Raises GpuError if it can't run,
        and torch.OutOfMemoryError if there is no memory for its code.
        """


_chosen: ContextVar[Launcher | None] = ContextVar("launcher", default=None)


def launcher_for(tensor: torch.Tensor) -> Launcher | None:
    """Return the launcher of the CUDA kernels for a tensor [...], or None for a tensor on the CPU.

    It is the launcher of the tensor's GPU or, inside `use_launcher`, the launcher given there. Raises GpuError if the
    GPU can't be used.
    """
    chosen = _chosen.get()
    if chosen is not None or tensor.device.type != "cuda":
        return chosen
    return cuda_launcher(tensor.get_device())


@contextmanager
def use_launcher(launcher: Launcher) -> Iterator[None]:
    """Run the operations of a `with` block as CUDA kernels on `launcher`, regardless of their tensors' devices."""
    token = _chosen.set(launcher)
    try:
        yield
    finally:
        _chosen.reset(token)


@cache
def cuda_launcher(device: int) -> CudaLauncher:
    """Return the launcher of a GPU, which holds the GPU's loaded kernels; each process makes it once."""
    return CudaLauncher(device)


class CudaLauncher:
    """A launcher on one GPU, which uses torch's current stream there.

    Raises GpuError for a driver older than the compiler, and for a GPU that the compiler doesn't know.
    """

    def __init__(self, device: int) -> None:
        try:
            from cuda.bindings import driver
        except ImportError as error:
            raise GpuError(f"cuda-bindings cannot be imported ({error}); {INSTALL}") from error
        torch.cuda.init()
        self._driver: Any = driver
        self._device = device
        check_driver(self._ask(driver.cuDriverGetVersion()), compiler_version())
        self._arch = arch_for(*torch.cuda.get_device_capability(device))
        self._modules: dict[str, Any] = {}
        self._launch_kernel = launch_function()
        self._kernels: dict[tuple[str, str], int] = {}
        self._ready = threading.local()

    def launch(self, family: str, kernel: str, blocks: int, threads: int, params: ctypes.Structure) -> None:
        if not blocks:
            return
        if torch.cuda.current_device() != self._device:  # checked first, since the guard takes longer
            with torch.cuda.device(self._device):
                return self.launch(family, kernel, blocks, threads, params)
        if not hasattr(self._ready, "context"):
            self._ready.context = self._make_current()
        function = self._kernels.get((family, kernel)) or self._load(family, kernel)
        addresses = ONE_ADDRESS(ctypes.addressof(params))
        stream = current_stream(self._device)
        status = self._launch_kernel(function, blocks, 1, 1, threads, 1, 1, 0, stream, addresses, None)
        if status != 0:
            self._ask((self._driver.CUresult(status),), kernel)

    def maps_memory(self) -> bool:
        """Return whether the driver maps memory of this GPU piece by piece, which some virtual GPUs refuse."""
        gpu = self._ask(self._driver.cuDeviceGet(self._device))
        attribute = self._driver.CUdevice_attribute.CU_DEVICE_ATTRIBUTE_VIRTUAL_MEMORY_MANAGEMENT_SUPPORTED
        return bool(self._ask(self._driver.cuDeviceGetAttribute(attribute, gpu)))

    def _make_current(self) -> Any:
        """Make the GPU's context current in this thread, and return it.

        Torch's threads for backward have no context until torch itself launches something there, and the driver refuses
        a launch without a context.
        """
        gpu = self._ask(self._driver.cuDeviceGet(self._device))
        context = self._ask(self._driver.cuDevicePrimaryCtxRetain(gpu))
        self._ask(self._driver.cuCtxSetCurrent(context))
        return context

    def _load(self, family: str, kernel: str) -> int:
        from cuda.core import ObjectCode

        if family not in self._modules:
            self._modules[family] = ObjectCode.from_cubin(compile_family(family, self._arch), name=family)
        try:
            handle = self._modules[family].get_kernel(kernel).handle
        except Exception as error:  # cuda-core's own class is private; its text begins with the driver's error name
            raise _failure(f"{kernel} cannot be loaded on GPU {self._device}: {error}") from error
        function = self._kernels[family, kernel] = int(handle)
        return function

    def _ask(self, result: tuple[Any, ...], what: str = "the CUDA driver") -> Any:
        status = result[0]
        if int(status) != 0:
            _, name = self._driver.cuGetErrorName(status)
            _, text = self._driver.cuGetErrorString(status)
            raise _failure(f"{what} failed on GPU {self._device}: {name.decode()}, {text.decode()}")
        return result[1] if len(result) > 1 else None


def launch_function() -> Callable[..., int]:
    """Return the driver's cuLaunchKernel as a ctypes function.

    cuda-bindings wraps every argument and the result in objects, which takes longer.
    """
    library = ctypes.CDLL("nvcuda.dll" if os.name == "nt" else "libcuda.so.1")
    function = library.cuLaunchKernel
    sizes = [ctypes.c_uint] * 7
    function.argtypes = [ctypes.c_void_p, *sizes, ctypes.c_void_p, ONE_ADDRESS, ctypes.c_void_p]
    function.restype = ctypes.c_int
    return function


def _failure(text: str) -> GpuError | torch.OutOfMemoryError:
    """Return the exception for an error text of the driver.

    If the driver is out of memory, it is torch's error, since torch may hold the memory, and callers that can do with
    less memory catch that error.
    """
    if "CUDA_ERROR_OUT_OF_MEMORY" in text:
        return torch.OutOfMemoryError(text)
    return LostGpuError(text) if any(name in text for name in LOST) else GpuError(text)


def compiler_version() -> tuple[int, int]:
    """Return NVRTC's version (major, minor), which is the version of its CUDA toolkit.

    Raises GpuError without NVRTC.
    """
    try:
        from cuda.bindings import nvrtc

        _, major, minor = nvrtc.nvrtcVersion()
    except (ImportError, RuntimeError) as error:
        raise GpuError(f"NVRTC, NVIDIA's run-time compiler, cannot be loaded ({error}); {INSTALL}") from error
    return major, minor


def check_driver(driver_version: int, compiler: tuple[int, int]) -> None:
    """Check that a driver's major version is not older than the compiler's, whose machine code it would refuse.

    driver_version: in the form of cuDriverGetVersion, 12040 for 12.4. Raises GpuError if it is older.
    """
    major, minor = driver_version // 1000, driver_version % 1000 // 10
    if major < compiler[0]:
        raise GpuError(
            f"the NVIDIA driver supports CUDA {major}.{minor}, but NVRTC {compiler[0]}.{compiler[1]} compiles the "
            "kernels; install a newer driver, or cuda-bindings and NVRTC of the driver's version (pip install "
            f"'cuda-bindings=={major}.*' nvidia-cuda-nvrtc-cu{major})"
        )
