"""Fixtures that every test may use."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import pytest

# Each worker of pytest-xdist keeps to one core, before libraries count the cores: threads of several workers that share
# all cores spend much of their time waiting for each other.
if worker := re.fullmatch(r"gw(\d+)", os.environ.get("PYTEST_XDIST_WORKER", "")):
    cores = sorted(os.sched_getaffinity(0))
    os.sched_setaffinity(0, {cores[int(worker[1]) % len(cores)]})

from mgsr.native import _image, runtime

if find_spec("OpenImageIO"):
    import_module("OpenImageIO")  # before pycolmap: the other way round, a file that it refuses ends the process

SHARED_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Return the measurement scenes beside a checkout, or skip the test where they are missing."""
    if not SHARED_DATA.is_dir():
        pytest.skip(f"NEEDS THE MEASUREMENT SCENES: no folder {SHARED_DATA.parent.name}/data beside the checkout")
    return SHARED_DATA


@pytest.fixture(scope="module")
def quick_report() -> Iterator[None]:
    """Make the reports of a module's runs quickly, for modules that neither look at pictures nor compare scores."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("mgsr.report.shading.OCCLUSION_RAYS", 1)
        patch.setattr("mgsr.report.shading.MOST_PIXELS", 96)
        patch.setattr("mgsr.metrics.surface.DENSE", 100_000)
        yield


@pytest.fixture
def kernel_settings_come_back() -> Iterator[None]:
    """Restore the kernels' variant and threads after a test that chooses them."""
    isa, threads = _image.isa(), _image.threads()
    yield
    runtime.set_isa(isa)
    runtime.set_threads(threads)
