"""A flash's file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from mgsr.errors import SceneError
from mgsr.export.flash import load_flash, write_flash
from mgsr.geometry.mesh import Mesh
from mgsr.shading.lighting import Lighting
from tests.mesh.shapes import looking_at_origin


def lighting() -> Lighting:
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.7)
    count = len(ball.vertices)
    besides = 0.1 + 0.05 * np.asarray(ball.vertices)[:, 2]
    return Lighting(
        Mesh(np.asarray(ball.vertices), np.asarray(ball.faces)), besides, np.arange(count)[::-1], 0.2, -0.1, 4.0
    )


def arrays() -> dict[str, Any]:
    full = lighting()
    lamp = np.array([full.right, full.down, full.lamp])
    return {
        "vertices": full.mesh.vertices,
        "faces": full.mesh.faces,
        "besides": full.ambient,
        "like": full.proxy_vertex,
        "lamp": lamp,
    }


def test_what_is_written_is_read(tmp_path: Path) -> None:
    write_flash(tmp_path / "flash.npz", lighting())
    found, view = load_flash(tmp_path / "flash.npz"), looking_at_origin(np.array([1.0, 2.0, 2.0]))
    assert np.array_equal(found.mesh.faces, lighting().mesh.faces) and np.array_equal(
        found.proxy_vertex, lighting().proxy_vertex
    )
    assert (found.right, found.down, found.lamp) == (0.2, -0.1, 4.0)
    assert np.abs(found.seen_by(view).astype(int) - lighting().seen_by(view)).max() <= 1


def test_a_far_surface_keeps_its_shape(tmp_path: Path) -> None:
    away, origin = np.array([512345.6, 4501234.4, 431.2]), np.array([512346.0, 4501234.0, 431.0])
    near = lighting().mesh
    far = replace(lighting(), mesh=near.moved(near.vertices + away))
    write_flash(tmp_path / "flash.npz", far, origin)
    np.testing.assert_allclose(load_flash(tmp_path / "flash.npz").mesh.vertices, far.mesh.vertices, rtol=0, atol=1e-7)
    with np.load(tmp_path / "flash.npz") as content:
        assert content["vertices"].dtype == np.float32
        np.testing.assert_allclose(content["vertices"] + content["origin"], far.mesh.vertices, rtol=0, atol=1e-7)


def test_a_near_surface_names_no_origin(tmp_path: Path) -> None:
    write_flash(tmp_path / "flash.npz", lighting(), np.zeros(3))
    with np.load(tmp_path / "flash.npz") as content:
        assert content.files == ["vertices", "faces", "besides", "like", "lamp"]


@pytest.mark.parametrize("content", [b"", b"no archive", b"PK\x03\x04 broken"])
def test_a_broken_file_is_named(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "flash.npz").write_bytes(content)
    with pytest.raises(SceneError, match=r"flash\.npz: the file holds no flash"):
        load_flash(tmp_path / "flash.npz")


@pytest.mark.parametrize(
    "other",
    [
        {"besides": np.zeros(3)},
        {"faces": np.zeros((0, 3))},
        {"faces": np.full((5, 3), 10**6)},
        {"like": np.full(642, -1)},
        {"lamp": np.zeros(2)},
        {"vertices": np.full((642, 3), np.nan)},
        {"origin": np.zeros(2)},
        {"origin": np.array([0, np.inf, 0])},
    ],
)
def test_other_arrays_are_refused(tmp_path: Path, other: dict[str, np.ndarray]) -> None:
    np.savez(tmp_path / "flash.npz", **(arrays() | other))
    with pytest.raises(SceneError, match=r"flash\.npz: expected finite vertices"):
        load_flash(tmp_path / "flash.npz")


def test_a_missing_array_is_named(tmp_path: Path) -> None:
    np.savez(tmp_path / "flash.npz", **{name: array for name, array in arrays().items() if name != "like"})
    with pytest.raises(SceneError, match="like"):
        load_flash(tmp_path / "flash.npz")
