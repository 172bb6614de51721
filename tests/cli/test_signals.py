"""Signals that end a command, in processes of their own."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import zipfile
from pathlib import Path

import pytest

from mgsr.cli.options import refusals

ENDLESS = """
import signal, sys, time
from pathlib import Path
from mgsr.cli.options import refusals
from mgsr.data import archive

def write(budget, member, place):
    place.write_bytes(b"half")
    print("unpacking", flush=True)
    time.sleep(60)

usual = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: signal.SIG_DFL, signal.SIGHUP: signal.SIG_DFL}
for number, handler in usual.items():  # whatever whoever runs the tests ignores
    signal.signal(number, signal.SIG_IGN if number.name == sys.argv[2] else handler)
archive._write = write
with refusals():
    archive.unpack(Path(sys.argv[1]))
"""


def unpacking(folder: Path, ignored: signal.Signals | None = None) -> subprocess.Popen[str]:
    """Start a command that unpacks to `folder`/tmp, and return it; it may ignore a signal as under nohup."""
    (folder / "tmp").mkdir()
    with zipfile.ZipFile(folder / "a.zip", "w") as out:
        out.writestr("a.png", "x")
    command = [sys.executable, "-c", ENDLESS, str(folder / "a.zip"), ignored.name if ignored else ""]
    environment, pipe = {"TMPDIR": str(folder / "tmp")}, subprocess.PIPE
    process = subprocess.Popen(command, env=environment, text=True, stdout=pipe, stderr=pipe)
    assert process.stdout is not None and process.stdout.readline() == "unpacking\n"
    assert list((folder / "tmp").glob("mgsr-scene-*/*/a.png"))
    return process


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
def test_what_was_unpacked_goes_with_the_command(tmp_path: Path, number: signal.Signals) -> None:
    process = unpacking(tmp_path)
    process.send_signal(number)
    process.communicate(timeout=30)
    assert not list((tmp_path / "tmp").iterdir())
    # refusals() ends a stop by Ctrl-C for Typer, which is not here.
    assert process.returncode == (1 if number == signal.SIGINT else 128 + number)


def test_an_ignored_hangup_stays_ignored(tmp_path: Path) -> None:
    process = unpacking(tmp_path, ignored=signal.SIGHUP)
    process.send_signal(signal.SIGHUP)
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(timeout=0.5)
    process.terminate()
    process.communicate(timeout=30)
    assert process.returncode == 128 + signal.SIGTERM


def test_signals_are_as_before_afterwards() -> None:
    before = [signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGINT)]
    with refusals():
        assert signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL
    assert [signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGINT)] == before


def test_other_threads_leave_signals_alone() -> None:
    trouble: list[bool | ValueError] = []

    def command() -> None:
        try:
            with refusals():
                trouble.append(signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL)
        except ValueError as error:  # what Python says of signals there
            trouble.append(error)

    thread = threading.Thread(target=command)
    thread.start()
    thread.join()
    assert trouble == [False]


def test_a_lost_gpu_ends_the_command_at_once(tmp_path: Path) -> None:
    """Check that unpacked files go, and that no object is destroyed: torch's tensors would abort the process."""
    program = """
import sys
from pathlib import Path
from mgsr.cli.options import refusals
from mgsr.data import archive
from mgsr.errors import LostGpuError

class OnTheGpu:
    def __del__(self):
        print("taken down")

tensor = OnTheGpu()
with refusals():
    print(archive.unpack(Path(sys.argv[1])))
    raise LostGpuError("the GPU failed")
"""
    (tmp_path / "tmp").mkdir()
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as out:
        out.writestr("a.png", "x")
    words = [sys.executable, "-c", program, str(tmp_path / "a.zip")]
    done = subprocess.run(words, env={"TMPDIR": str(tmp_path / "tmp")}, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (2, "error: the GPU failed\n")
    assert done.stdout.startswith(str(tmp_path / "tmp")) and len(done.stdout.splitlines()) == 1
    assert not list((tmp_path / "tmp").iterdir())
