"""List the NVIDIA GPUs by names for CUDA_VISIBLE_DEVICES.

They come from NVML, the driver's library that nvidia-smi uses. CUDA itself would have to be loaded into this process.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import takewhile
from typing import Any

from service.contract.errors import SetupError

NAME_THEM = "or name the GPUs by number: --gpus 0,1"


@dataclass(frozen=True)
class Gpu:
    """A GPU as NVML reports it.

    uuid: GPU-.... model: its name. instances: the uuids (MIG-...) of the instances into which MIG divides the GPU,
    or None if MIG is off.
    """

    uuid: str
    model: str
    instances: tuple[str, ...] | None


def all_gpus() -> list[str]:
    """Return every device that this process may use: GPUs, and the instances of a GPU in MIG mode.

    CUDA_VISIBLE_DEVICES limits them if it is set. Raises SetupError if there is none, or NVML fails.
    """
    visible = os.environ.get("CUDA_VISIBLE_DEVICES")
    found = _named_by_nvml() if visible is None else _named_by(visible)
    if not found:
        raise SetupError(
            "--gpus all: found no NVIDIA driver or GPU; CUDA_VISIBLE_DEVICES may hide it, or MIG is on without an "
            "instance (nvidia-smi -L lists them); remove --gpus to use the CPU"
        )
    return found


def _named_by_nvml() -> list[str]:
    """Return the devices by number if each GPU is one device, else by uuid.

    CUDA numbers GPUs in MIG mode differently.
    """
    gpus = ask_nvml()
    if all(gpu.instances is None for gpu in gpus):
        return [str(number) for number, _ in enumerate(gpus)]
    return [uuid for gpu in gpus for uuid in _devices(gpu)]


def _named_by(visible: str) -> list[str]:
    """Return the devices that CUDA_VISIBLE_DEVICES names, up to the first invalid entry, as CUDA does.

    A GPU in MIG mode stands for its instances. NVML is not needed for the other GPUs.
    """
    names = [name.strip() for name in visible.split(",")]
    names = list(takewhile(lambda name: name and not name.startswith("-"), names))
    try:
        gpus = ask_nvml() if names else []
    except SetupError:
        return names
    return list(dict.fromkeys(device for name in names for device in _resolve(name, gpus)))


def _resolve(name: str, gpus: list[Gpu]) -> tuple[str, ...]:
    named = _find(name, gpus)
    return (name,) if named is None or named.instances is None else _devices(named)


def _find(name: str, gpus: list[Gpu]) -> Gpu | None:
    """Return the GPU with a number, or with a uuid that begins with `name`.

    NVML orders GPUs by their places on the bus. CUDA orders them by speed unless CUDA_DEVICE_ORDER says otherwise. A
    number means the same to both only if all GPUs are of one model.
    """
    if not name.isdecimal():
        return next((gpu for gpu in gpus if gpu.uuid.startswith(name)), None)
    same = os.environ.get("CUDA_DEVICE_ORDER") == "PCI_BUS_ID" or len({gpu.model for gpu in gpus}) == 1
    return gpus[int(name)] if same and int(name) < len(gpus) else None


def _devices(gpu: Gpu) -> tuple[str, ...]:
    return (gpu.uuid,) if gpu.instances is None else gpu.instances


def ask_nvml() -> list[Gpu]:
    """Return the GPUs of this machine or container.

    Raises SetupError if NVML or its package is missing or fails.
    """
    try:
        import pynvml
    except ImportError as error:
        raise SetupError(
            f"--gpus all: counting GPUs requires the package nvidia-ml-py; run pip install 'mgsr[cuda]', {NAME_THEM}"
        ) from error
    with _nvml(pynvml):
        handles = [pynvml.nvmlDeviceGetHandleByIndex(i) for i in range(pynvml.nvmlDeviceGetCount())]
        return [
            Gpu(pynvml.nvmlDeviceGetUUID(h), pynvml.nvmlDeviceGetName(h), _mig_instances(pynvml, h)) for h in handles
        ]


@contextmanager
def _nvml(pynvml: Any) -> Iterator[None]:
    """Initialise NVML for a block. Raises SetupError for any NVML error in it."""
    try:
        pynvml.nvmlInit()
        try:
            yield
        finally:
            pynvml.nvmlShutdown()
    except pynvml.NVMLError as error:
        raise SetupError(
            f"--gpus all: the NVIDIA driver does not answer ({error}); check that nvidia-smi works, {NAME_THEM}, or "
            "remove --gpus to use the CPU"
        ) from error


def _mig_instances(pynvml: Any, handle: Any) -> tuple[str, ...] | None:
    try:
        mode, _ = pynvml.nvmlDeviceGetMigMode(handle)
    except (pynvml.NVMLError_NotSupported, pynvml.NVMLError_FunctionNotFound):  # GPU or driver does not support MIG
        return None
    if mode != pynvml.NVML_DEVICE_MIG_ENABLE:
        return None
    uuids: list[str] = []
    for place in range(pynvml.nvmlDeviceGetMaxMigDeviceCount(handle)):
        with suppress(pynvml.NVMLError_NotFound, pynvml.NVMLError_NoPermission):  # none there, or not this container's
            uuids.append(pynvml.nvmlDeviceGetUUID(pynvml.nvmlDeviceGetMigDeviceHandleByIndex(handle, place)))
    return tuple(uuids)
