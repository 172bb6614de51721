"""Which device a run gets."""

from __future__ import annotations

import pytest
import torch

from mgsr.errors import ConfigError, GpuError
from mgsr.pipeline import device
from mgsr.pipeline.device import Device, pick_device


def test_the_processor_is_always_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert pick_device("cpu") is Device.CPU
    assert pick_device("auto") is Device.CPU
    with pytest.raises(ConfigError, match="device cuda: the installed torch"):
        pick_device("cuda")
    with pytest.raises(ConfigError, match="auto, cpu, cuda"):
        pick_device("tpu")


def test_a_usable_gpu_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "current_device", lambda: 0)
    monkeypatch.setattr(device, "cuda_launcher", lambda index: f"launcher {index}")
    prepared: list[object] = []
    monkeypatch.setattr(device, "prefer_expandable_segments", prepared.append)
    assert pick_device("auto") is Device.CUDA and pick_device("cuda") is Device.CUDA
    assert pick_device("cpu") is Device.CPU
    assert prepared == ["launcher 0", "launcher 0"]


def test_a_gpu_that_can_not_be_used(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(index: int) -> None:
        raise GpuError("the driver is old")

    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "current_device", lambda: 0)
    monkeypatch.setattr(device, "cuda_launcher", refuse)
    assert pick_device("auto") is Device.CPU
    with pytest.raises(GpuError, match="the driver is old"):
        pick_device("cuda")
