"""The launch helper against a driver that only prints what it is asked for."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.cuda_shim.launcher import HERE

PROGRAM = """
import ctypes, contextlib, sys, threading
from pathlib import Path
import torch
from mgsr.errors import GpuError
from mgsr.native.cuda import launcher
from mgsr.native.cuda.launcher import CudaLauncher

class Params(ctypes.Structure):
    _fields_ = (("first", ctypes.c_int64), ("second", ctypes.c_int32))

torch.cuda.init = lambda: None
torch.cuda.get_device_capability = lambda device: (9, 0)
launcher.current_stream = lambda device: 0x7F00
torch.cuda.current_device = lambda: current[0]

@contextlib.contextmanager
def device(index):
    current[:] = [index]
    print(f"device {index}", flush=True)
    yield

current = [0]
torch.cuda.device = device
# The compiler asks a driver more than this one knows, and is tested elsewhere.
launcher.compile_family = lambda family, arch: Path(sys.argv[1]).read_bytes()
GPU = CudaLauncher(0)
GPU.launch("adam", "adam_update", 7, 128, Params(4242, 1))
GPU.launch("adam", "adam_update", 8, 64, Params(-1, 1))
GPU.launch("adam", "adam_update", 0, 64, Params(5, 1))
# As torch's backward does, in a thread that has not touched the GPU.
backward = threading.Thread(target=GPU.launch, args=("adam", "adam_update", 3, 64, Params(7, 1)))
backward.start()
backward.join()
current[0] = 3
GPU.launch("adam", "adam_update", 9, 32, Params(6, 1))
for kernel in ("refused", "large", "huge", "lost"):
    try:
        GPU.launch("adam", kernel, 1, 32, Params(0, 0))
    except (GpuError, torch.OutOfMemoryError) as error:
        print(f"{type(error).__name__}: {error}", flush=True)
print("maps memory", GPU.maps_memory())
"""


def test_what_the_driver_is_asked_for(tmp_path: Path) -> None:
    pytest.importorskip("cuda.core", reason="NEEDS NVRTC: pip install 'mgsr[cuda]'")
    from mgsr.native.cuda.compiler import compile_family

    driver, cubin = tmp_path / "libcuda.so.1", tmp_path / "adam.cubin"
    subprocess.run(["gcc", "-shared", "-fPIC", str(HERE / "fake_driver.c"), "-o", str(driver)], check=True)
    cubin.write_bytes(compile_family("adam", "sm_90", tmp_path / "cache"))
    environment = os.environ | {"LD_LIBRARY_PATH": str(tmp_path), "PYTHONPATH": os.pathsep.join(sys.path)}
    program = [sys.executable, "-c", PROGRAM, str(cubin)]
    done = subprocess.run(program, env=environment, capture_output=True, text=True, check=True)
    *printed, huge, maps = sorted(done.stdout.splitlines(), key=lambda line: ("maps" in line, "huge" in line, line))
    assert maps == "maps memory True"
    assert huge.startswith("OutOfMemoryError: huge cannot be loaded on GPU 0: CUDA_ERROR_OUT_OF_MEMORY")
    assert printed == [
        "GpuError: refused failed on GPU 0: CUDA_ERROR_INVALID_VALUE, invalid argument",
        "LostGpuError: lost failed on GPU 0: CUDA_ERROR_ILLEGAL_ADDRESS, unknown error",
        "OutOfMemoryError: large failed on GPU 0: CUDA_ERROR_OUT_OF_MEMORY, out of memory",
        "device 0",
        "launch 0x1234 blocks 3 1 1 threads 64 1 1 shared 0 stream 0x7f00 first parameter 7 extra 0",
        "launch 0x1234 blocks 7 1 1 threads 128 1 1 shared 0 stream 0x7f00 first parameter 4242 extra 0",
        "launch 0x1234 blocks 8 1 1 threads 64 1 1 shared 0 stream 0x7f00 first parameter -1 extra 0",
        "launch 0x1234 blocks 9 1 1 threads 32 1 1 shared 0 stream 0x7f00 first parameter 6 extra 0",
        "load ELF",
    ]
