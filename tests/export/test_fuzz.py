"""Damaged files of splats, meshes and light: a reader gives their content or one error of ours."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import settings

from mgsr.errors import MgsrError
from mgsr.export.compressed_ply import load_compressed_ply, write_compressed_ply
from mgsr.export.environment_map import load_environment_map, write_environment_map
from mgsr.export.flash import load_flash, write_flash
from mgsr.export.mesh_files import write_glb, write_ply
from mgsr.export.mesh_reading import load_mesh
from mgsr.export.obj_files import write_obj
from mgsr.export.ply_notes import read_origin
from mgsr.export.splats import load_splats, write_splats
from mgsr.export.spz import load_spz, read_spz_origin, write_spz
from tests.export.test_environment_map import stored_environment_map
from tests.export.test_flash import lighting
from tests.export.test_mesh_files import mesh_and_colors
from tests.export.test_packed_splats import splats
from tests.fuzzing import LONG, QUICK, byte_changes, fuzz

CORNERS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
MESH = (CORNERS, np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]), np.eye(4)[:, :3] + 0.1, CORNERS)
ORIGIN = np.array([512346.0, 4501234.0, 431.0])

SPLATS: dict[str, tuple[Callable[..., None], Callable[[Path], Any]]] = {
    "a.ply": (write_splats, load_splats),
    "a.compressed.ply": (write_compressed_ply, load_compressed_ply),
    "a.spz": (write_spz, load_spz),
    "far.ply": (partial(write_splats, origin=ORIGIN), lambda path: (load_splats(path), read_origin(path))),
    "far.spz": (partial(write_spz, origin=ORIGIN), lambda path: (load_spz(path), read_spz_origin(path))),
}
LIGHTS: dict[str, tuple[Callable[[Path], None], Callable[[Path], Any]]] = {
    "flash.npz": (lambda path: write_flash(path, lighting(), ORIGIN), load_flash),
    "mirrored_light.npz": (
        partial(write_environment_map, stored=stored_environment_map(), origin=ORIGIN),
        load_environment_map,
    ),
}
MESHES: dict[str, Callable[..., None]] = {"mesh.ply": write_ply, "mesh.glb": write_glb, "mesh.obj": write_obj}


def fuzz_file(root: Path, name: str, how: settings) -> None:
    path = root / name
    if name in MESHES:
        MESHES[name](path, *mesh_and_colors(*MESH))
        load: Callable[[Path], Any] = load_mesh
    elif name in LIGHTS:
        LIGHTS[name][0](path)
        load = LIGHTS[name][1]
    else:
        write, load = SPLATS[name]
        write(path, splats(5, coefficients=4))
    fuzz(path, lambda: load(path), MgsrError, byte_changes(), how)


@pytest.mark.parametrize("name", [*SPLATS, *MESHES, *LIGHTS])
def test_damaged_files(tmp_path: Path, name: str) -> None:
    fuzz_file(tmp_path, name, QUICK)


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("name", [*SPLATS, *MESHES, *LIGHTS])
def test_damaged_files_for_long(tmp_path: Path, name: str) -> None:
    fuzz_file(tmp_path, name, LONG)
