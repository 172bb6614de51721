"""One service for all quick tests, and the captures that they send."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.cli.spheres import write_spheres
from tests.service.stack import Stack, zip_folder


@pytest.fixture(scope="session")
def tiny_archive(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Provide eight photographs of three spheres, 32 x 32, as a zip."""
    folder = write_spheres(tmp_path_factory.mktemp("tiny") / "spheres", size=32, train=8, test=1)
    (folder / "mesh_gt.ply").unlink()  # scoring against it takes longer than the rest
    return zip_folder(folder)


@pytest.fixture(scope="session")
def stack(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    """Yield API, one worker, a queue and a folder as store, without keys."""
    with Stack(tmp_path_factory.mktemp("stack")) as running:
        yield running
