"""Torch's allocator grows its segments of a GPU's memory, unless the user or the system wants it otherwise."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from dataclasses import dataclass
from typing import Any

import pytest

from mgsr.pipeline import device
from mgsr.pipeline.device import OF_USER, prefer_expandable_segments


@dataclass
class Gpu:
    """A stand-in for a launcher."""

    maps: bool

    def maps_memory(self) -> bool:
        return self.maps


MAPS: Any = Gpu(maps=True)
MAPS_NOT: Any = Gpu(maps=False)


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return the settings that are made on Linux where the user has set none."""
    for name in OF_USER:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(platform, "release", lambda: "6.8.0-45-generic")
    settings: list[str] = []
    monkeypatch.setattr(device, "_set_allocator", settings.append)
    return settings


def test_segments_grow(made: list[str]) -> None:
    prefer_expandable_segments(MAPS)
    assert made == ["expandable_segments:True"]


@pytest.mark.parametrize("name", OF_USER)
@pytest.mark.parametrize("value", ["", "0", "max_split_size_mb:64"])
def test_what_the_user_has_set_stays(name: str, value: str, made: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(name, value)
    prefer_expandable_segments(MAPS)
    assert not made


def test_not_where_memory_is_not_mapped(made: list[str]) -> None:
    prefer_expandable_segments(MAPS_NOT)
    assert not made


@pytest.mark.parametrize("release", ["5.15.167.4-microsoft-standard-WSL2", "4.4.0-19041-Microsoft"])
def test_not_under_wsl(release: str, made: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(platform, "release", lambda: release)
    prefer_expandable_segments(MAPS)
    assert not made


def test_not_under_windows(made: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "win32")
    prefer_expandable_segments(MAPS)
    assert not made


PROGRAM = """
import platform, torch
from mgsr.pipeline.device import prefer_expandable_segments
from tests.pipeline.test_allocator import MAPS
platform.release = lambda: "6.8.0-45-generic"
prefer_expandable_segments(MAPS)
print(torch._C._accelerator_getAllocatorSettings())
"""


@pytest.mark.parametrize(
    ("set_by_user", "settings"), [({}, "expandable_segments:True"), ({OF_USER[0]: "backend:native"}, "backend:native")]
)
def test_torch_takes_the_settings(set_by_user: dict[str, str], settings: str) -> None:
    """Check that torch takes the settings, in a process of its own, since they hold for all of it."""
    own = {name: value for name, value in os.environ.items() if name not in OF_USER}
    environment = own | {"PYTHONPATH": os.pathsep.join(sys.path)} | set_by_user
    ran = subprocess.run([sys.executable, "-c", PROGRAM], env=environment, capture_output=True, text=True)
    assert ran.stdout.strip() == settings, ran.stderr
