"""The environment map's file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mgsr.errors import SceneError
from mgsr.export.environment_map import StoredEnvironmentMap, load_environment_map, write_environment_map
from mgsr.geometry.mesh import Mesh

MAPS: dict[str, Any] = {"scene": np.zeros((4, 4, 3)), "camera": np.zeros((4, 4, 3))}
MESH = {"vertices": np.eye(3), "faces": np.array([[0, 1, 2]])}


def stored_environment_map() -> StoredEnvironmentMap:
    """Return environment maps with a triangle that reflects, far from the origin."""
    generator = np.random.default_rng(0)
    maps = generator.random((2, 3, 4, 4)).astype(np.float32)
    corners = np.add(np.eye(3), [512346.25, 4501234.5, 431.0])
    return StoredEnvironmentMap(maps, np.array([0.5, 0.25, 0.125], np.float32), Mesh(corners, np.array([[0, 1, 2]])))


def test_what_is_written_is_read(tmp_path: Path) -> None:
    light = stored_environment_map()
    write_environment_map(tmp_path / "light.npz", light, np.array([512346.0, 4501234.0, 431.0]))
    read = load_environment_map(tmp_path / "light.npz")
    assert np.array_equal(read.maps, light.maps) and np.array_equal(read.bounce, light.bounce)
    assert read.surface is not None and light.surface is not None
    assert np.array_equal(read.surface.vertices, light.surface.vertices)
    assert np.array_equal(read.surface.faces, light.surface.faces)
    with np.load(tmp_path / "light.npz") as content:  # as its own description says, without our reader
        assert np.array_equal(content["camera"][1, 2], light.maps[1, :, 1, 2])
        assert np.array_equal(content["vertices"] + content["origin"], light.surface.vertices)


def test_a_light_without_a_mesh_is_read(tmp_path: Path) -> None:
    write_environment_map(tmp_path / "light.npz", StoredEnvironmentMap(np.ones((2, 3, 4, 4)), np.ones(3)))
    assert load_environment_map(tmp_path / "light.npz").surface is None


def test_maps_alone_are_a_light(tmp_path: Path) -> None:
    np.savez(tmp_path / "light.npz", **MAPS)
    light = load_environment_map(tmp_path / "light.npz")
    assert light.surface is None and np.array_equal(light.bounce, np.ones(3))


@pytest.mark.parametrize("content", [b"", b"no archive", b"PK\x03\x04 broken"])
def test_a_broken_file_is_named(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "light.npz"
    path.write_bytes(content)
    with pytest.raises(SceneError, match=r"light\.npz: the file holds no environment map"):
        load_environment_map(path)


@pytest.mark.parametrize(
    "arrays",
    [
        {"scene": np.zeros((4, 4, 3))},
        {"scene": np.zeros((4, 4, 3)), "camera": np.zeros((5, 5, 3))},
        {"scene": np.float32(1), "camera": np.float32(1)},
        {**MAPS, "scene": np.full((4, 4, 3), np.nan)},
        {**MAPS, "bounce": np.ones(4)},
        {**MAPS, "vertices": np.eye(3)},
        {**MAPS, **MESH, "faces": np.array([[0, 1, 3]])},
        {**MAPS, **MESH, "faces": np.zeros((0, 3), int)},
        {**MAPS, **MESH, "vertices": np.full((3, 3), np.inf)},
        {**MAPS, **MESH, "origin": np.zeros(2)},
    ],
)
def test_other_arrays_are_refused(tmp_path: Path, arrays: dict[str, Any]) -> None:
    np.savez(tmp_path / "light.npz", **arrays)
    with pytest.raises(SceneError, match=r"light\.npz"):
        load_environment_map(tmp_path / "light.npz")
