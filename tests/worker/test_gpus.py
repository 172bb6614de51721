"""One worker for each GPU, by one command."""

from __future__ import annotations

import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from service.contract.errors import SetupError
from tests.service.stack import ROOT, TINY_OPTIONS, Stack, kill_process
from worker import start


def gpus_of(parent: int) -> dict[int, str]:
    """Return the GPU that each child of a process may use, by the child's process id."""
    found: dict[int, str] = {}
    for pid in Path(f"/proc/{parent}/task/{parent}/children").read_text().split():
        with suppress(OSError):  # it has just ended
            variables = Path(f"/proc/{pid}/environ").read_bytes().decode().split("\0")
            found |= {int(pid): value[21:] for value in variables if value.startswith("CUDA_VISIBLE_DEVICES=")}
    return found


@pytest.mark.slow
def test_a_worker_for_each_gpu(tmp_path: Path, tiny_archive: bytes) -> None:
    """Check that jobs that ask for a GPU wait for a worker with one, and that a signal to the first ends all."""
    with Stack(tmp_path, workers=1) as stack:
        job = stack.submitted(tiny_archive, TINY_OPTIONS | {"device": "cuda"})
        other = stack.submitted(tiny_archive, TINY_OPTIONS)
        stack.wait_for(other, "succeeded")
        assert stack.job(job)["status"] == "queued"
        command = [sys.executable, "-m", "worker.cli", "--gpus", "0,1"]
        with subprocess.Popen(command, env=stack.environment, cwd=ROOT) as workers:
            stack.wait_until_ready(3)
            stack.finished(job)
            workers.terminate()
            assert workers.wait(30) == 0
        assert stack.http.get("/readyz").json()["workers"] == 1


def test_a_gpus_worker_that_dies_starts_again(tmp_path: Path) -> None:
    with Stack(tmp_path, workers=0) as stack:
        command = [sys.executable, "-m", "worker.cli", "--gpus", "0,1"]
        with subprocess.Popen(command, env=stack.environment, cwd=ROOT) as workers:
            stack.wait_until_ready(2)
            before = gpus_of(workers.pid)
            assert sorted(before.values()) == ["0", "1"]
            kill_process(max(before))
            while max(before) in (now := gpus_of(workers.pid)) or len(now) < 2:
                time.sleep(0.1)
            assert sorted(now.values()) == ["0", "1"] and min(before) in now
            workers.terminate()
            assert workers.wait(30) == 0


class Nvml(ModuleType):
    """A stand-in for pynvml.

    GPUs: by uuid, model, and what MIG makes of it: the uuids at its places, None where there is no instance; "off"; or
    "none" where the GPU has no MIG. fails: the function that fails.
    """

    NVML_DEVICE_MIG_ENABLE = 1

    class NVMLError(Exception):
        pass

    class NVMLError_NotSupported(NVMLError):  # noqa: N801, as pynvml calls it
        pass

    class NVMLError_FunctionNotFound(NVMLError):  # noqa: N801
        pass

    class NVMLError_NotFound(NVMLError):  # noqa: N801
        pass

    class NVMLError_NoPermission(NVMLError):  # noqa: N801
        pass

    def __init__(self, *gpus: tuple[str, str, list[str | None] | str], fails: str = "") -> None:
        super().__init__("pynvml")
        self._gpus, self._fails = gpus, fails
        self.open = 0

    def __getattribute__(self, name: str) -> Any:
        if name.startswith("nvml") and name == object.__getattribute__(self, "_fails"):
            raise Nvml.NVMLError("NVML Shared Library Not Found")
        return object.__getattribute__(self, name)

    def nvmlInit(self) -> None:  # noqa: N802
        self.open += 1

    def nvmlShutdown(self) -> None:  # noqa: N802
        self.open -= 1

    def nvmlDeviceGetCount(self) -> int:  # noqa: N802
        assert self.open == 1
        return len(self._gpus)

    def nvmlDeviceGetHandleByIndex(self, index: int) -> tuple[int, int | None]:  # noqa: N802
        return index, None

    def nvmlDeviceGetName(self, handle: tuple[int, int | None]) -> str:  # noqa: N802
        return self._gpus[handle[0]][1]

    def nvmlDeviceGetUUID(self, handle: tuple[int, int | None]) -> str:  # noqa: N802
        uuid, _, places = self._gpus[handle[0]]
        return uuid if handle[1] is None else str(places[handle[1]])

    def nvmlDeviceGetMigMode(self, handle: tuple[int, int | None]) -> list[int]:  # noqa: N802
        mig = self._gpus[handle[0]][2]
        if mig == "none":
            raise Nvml.NVMLError_NotSupported("Not Supported")
        return [0, 1] if mig == "off" else [1, 1]

    def nvmlDeviceGetMaxMigDeviceCount(self, handle: tuple[int, int | None]) -> int:  # noqa: N802
        return len(self._gpus[handle[0]][2])

    def nvmlDeviceGetMigDeviceHandleByIndex(self, handle: tuple[int, int | None], place: int) -> Any:  # noqa: N802
        if self._gpus[handle[0]][2][place] is None:
            raise Nvml.NVMLError_NotFound("Not Found")
        return handle[0], place


T4 = ("GPU-t4", "Tesla T4", "none")
A100 = ("GPU-a100", "NVIDIA A100", "off")
CUT = ("GPU-cut", "NVIDIA A100", ["MIG-1", None, "MIG-2", None])
EMPTY = ("GPU-empty", "NVIDIA A100", [None, None])


@pytest.fixture(autouse=True)
def environment(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("CUDA_VISIBLE_DEVICES", "CUDA_DEVICE_ORDER"):
        monkeypatch.delenv(name, raising=False)


def started(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return the devices that `--gpus all` starts workers for."""
    seen: list[str] = []
    monkeypatch.setattr(start, "_one_for_each", seen.extend)
    start.start_workers("all")
    return seen


@pytest.mark.parametrize(
    ("machine", "devices"),
    [
        ([T4], ["0"]),
        ([A100, T4, A100], ["0", "1", "2"]),
        ([CUT], ["MIG-1", "MIG-2"]),
        ([T4, CUT, A100], ["GPU-t4", "MIG-1", "MIG-2", "GPU-a100"]),
        ([EMPTY, A100], ["GPU-a100"]),
    ],
)
def test_all_gpus_are_those_that_nvml_lists(machine: list[Any], devices: list[str], monkeypatch: Any) -> None:
    nvml = Nvml(*machine)
    monkeypatch.setitem(sys.modules, "pynvml", nvml)
    assert started(monkeypatch) == devices
    assert nvml.open == 0


@pytest.mark.parametrize(
    ("visible", "order", "machine", "devices"),
    [
        ("2,1", "", [A100, A100, A100], ["2", "1"]),
        (" 1 , GPU-a", "", [A100, A100], ["1", "GPU-a"]),
        ("MIG-2", "", [CUT], ["MIG-2"]),
        ("GPU-c", "", [T4, CUT], ["MIG-1", "MIG-2"]),
        ("1,0", "", [A100, CUT], ["MIG-1", "MIG-2", "0"]),
        ("1", "", [T4, CUT], ["1"]),  # which is the faster one, only CUDA knows
        ("1", "PCI_BUS_ID", [T4, CUT], ["MIG-1", "MIG-2"]),
        ("0,GPU-cut", "", [CUT], ["MIG-1", "MIG-2"]),
        ("1,-1,0", "", [A100, A100], ["1"]),
        ("7", "", [A100], ["7"]),
    ],
)
def test_the_environment_limits_all_gpus(
    visible: str, order: str, machine: list[Any], devices: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pynvml", Nvml(*machine))
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", visible)
    monkeypatch.setenv("CUDA_DEVICE_ORDER", order)
    assert started(monkeypatch) == devices


def test_what_the_environment_names_needs_no_nvml(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pynvml", None)
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "1,GPU-a")
    assert started(monkeypatch) == ["1", "GPU-a"]


@pytest.mark.parametrize(
    ("visible", "machine"), [(None, []), (None, [EMPTY]), ("", [A100]), ("-1", [A100]), ("0", [EMPTY])]
)
def test_no_gpu_is_told(visible: str | None, machine: list[Any], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pynvml", Nvml(*machine))
    if visible is not None:
        monkeypatch.setenv("CUDA_VISIBLE_DEVICES", visible)
    with pytest.raises(SetupError, match="--gpus all: found no NVIDIA driver or GPU"):
        start.start_workers("all")


@pytest.mark.parametrize("fails", ["nvmlInit", "nvmlDeviceGetCount", "nvmlDeviceGetHandleByIndex", "nvmlDeviceGetUUID"])
def test_nvml_that_fails_is_told_with_the_cure(fails: str, monkeypatch: pytest.MonkeyPatch) -> None:
    nvml = Nvml(A100, fails=fails)
    monkeypatch.setitem(sys.modules, "pynvml", nvml)
    with pytest.raises(SetupError, match=r"Shared Library Not Found.*nvidia-smi.*--gpus 0,1"):
        start.start_workers("all")
    assert nvml.open == 0


def test_without_nvml_the_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pynvml", None)
    with pytest.raises(SetupError, match=r"nvidia-ml-py.*pip install 'mgsr\[cuda\]'.*--gpus 0,1"):
        start.start_workers("all")


def test_the_stand_in_has_what_the_package_has() -> None:
    real = pytest.importorskip("pynvml", reason="NEEDS nvidia-ml-py: pip install 'mgsr[cuda]'")
    used = [name for name in vars(Nvml) if name.startswith(("nvml", "NVML"))]
    assert len(used) > 10 and all(hasattr(real, name) for name in used)
    for name in used:
        if name.startswith("NVMLError_"):
            assert issubclass(getattr(real, name), real.NVMLError)
