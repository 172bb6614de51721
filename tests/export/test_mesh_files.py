"""Mesh files, read back by other libraries."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from plyfile import PlyData
from scipy.spatial.transform import Rotation

from mgsr.data.images import srgb_to_linear
from mgsr.errors import MeshError
from mgsr.export.convert import convert
from mgsr.export.gltf import PbrMaterial, UpAxis
from mgsr.export.mesh_files import png_bytes, write_glb, write_ply, write_textured_glb
from mgsr.export.obj_files import write_obj
from mgsr.export.ply_notes import UNIT, read_number
from mgsr.geometry.mesh import Mesh

Arrays = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def ball(offset: float = 0.0) -> Arrays:
    mesh = trimesh.creation.icosphere(subdivisions=2)
    colors = np.random.default_rng(0).random((len(mesh.vertices), 3))
    return mesh.vertices + offset, mesh.faces, np.array(mesh.vertex_normals), colors


def mesh_and_colors(
    vertices: np.ndarray, faces: np.ndarray, normals: np.ndarray, colors: np.ndarray
) -> tuple[Mesh, np.ndarray]:
    """Return a mesh with given normals, and its colours."""
    return Mesh(vertices, faces).with_normals(normals), colors


def test_ply_holds_what_was_given(tmp_path: Path) -> None:
    vertices, faces, normals, colors = ball()
    write_ply(tmp_path / "mesh.ply", *mesh_and_colors(vertices, faces, normals, colors))
    data = PlyData.read(str(tmp_path / "mesh.ply"))
    read = data["vertex"]
    np.testing.assert_allclose(np.stack([read[axis] for axis in "xyz"], 1), vertices, atol=1e-7)
    np.testing.assert_allclose(np.stack([read[name] for name in ("nx", "ny", "nz")], 1), normals, atol=1e-7)
    shades = np.stack([read[name] for name in ("red", "green", "blue")], 1)
    assert shades.dtype == np.uint8
    np.testing.assert_allclose(shades / 255, colors, atol=0.5 / 255 + 1e-9)
    np.testing.assert_array_equal(np.stack(data["face"]["vertex_indices"]), faces)


def test_ply_far_from_the_origin_keeps_its_shape(tmp_path: Path) -> None:
    vertices, faces, normals, colors = ball(offset=5e6)
    write_ply(tmp_path / "mesh.ply", *mesh_and_colors(vertices, faces, normals, colors))
    read = PlyData.read(str(tmp_path / "mesh.ply"))["vertex"]
    np.testing.assert_allclose(np.stack([read[axis] for axis in "xyz"], 1), vertices, rtol=0, atol=1e-8)


@pytest.mark.parametrize("offset", [0.0, 5e6])
def test_glb_holds_what_was_given(tmp_path: Path, offset: float) -> None:
    vertices, faces, normals, colors = ball(offset)
    write_glb(tmp_path / "mesh.glb", *mesh_and_colors(vertices, faces, normals, colors))
    scene = trimesh.load_scene(tmp_path / "mesh.glb", process=False)
    (node,) = scene.graph.nodes_geometry
    pose, name = scene.graph[node]
    mesh = scene.geometry[name]
    np.testing.assert_allclose(trimesh.transform_points(mesh.vertices, pose), vertices, atol=1e-6)
    np.testing.assert_array_equal(mesh.faces, faces)
    np.testing.assert_allclose(mesh.vertex_normals, normals, atol=1e-6)


def test_glb_colours_are_linear_and_fine(tmp_path: Path) -> None:
    vertices, faces, normals, _ = ball()
    colors = np.linspace(0, 0.1, len(vertices) * 3).reshape(-1, 3)  # dark: 8 linear bits would keep three levels
    write_glb(tmp_path / "mesh.glb", *mesh_and_colors(vertices, faces, normals, colors))
    data = (tmp_path / "mesh.glb").read_bytes()
    length = int.from_bytes(data[12:16], "little")
    document = json.loads(data[20 : 20 + length])
    view = document["bufferViews"][document["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"]]
    stored = np.frombuffer(data[28 + length :], "<f4", len(vertices) * 4, view["byteOffset"]).reshape(-1, 4)
    # The sRGB curve's other direction, as IEC 61966-2-1 has it.
    linear = stored[:, :3]
    back = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)
    np.testing.assert_allclose(back, colors, atol=1e-6)
    assert (stored[:, 3] == 1).all()


def square(picture: np.ndarray) -> tuple[Mesh, np.ndarray, np.ndarray, PbrMaterial]:
    """Return a square whose picture has its upper left corner at (0, 1, 0), seen from z, with tangents and material."""
    vertices = np.array([[0.0, 1, 0], [0, 0, 0], [1, 0, 0], [1, 1, 0]])
    uvs = np.array([[0.0, 0], [0, 1], [1, 1], [1, 0]])
    normals, faces = np.tile([0.0, 0, 1], (4, 1)), np.array([[0, 1, 2], [0, 2, 3]])
    flat, open_sky = np.full((4, 4, 3), (128, 128, 255), np.uint8), np.full((2, 2), 200, np.uint8)
    material = PbrMaterial(png_bytes(picture), png_bytes(flat), png_bytes(open_sky), roughness=0.25, metallic=1.0)
    return Mesh(vertices, faces).with_normals(normals), uvs, np.tile([1.0, 0, 0, 1], (4, 1)), material


def test_textured_glb_puts_the_picture_where_it_belongs(tmp_path: Path) -> None:
    """Check a square whose upper left corner, seen from z, is red; trimesh's uvs begin at the lower left instead."""
    picture = np.zeros((8, 8, 3), np.uint8)
    picture[:4, :4], picture[4:, 4:] = (200, 10, 20), (1, 2, 250)
    given, uvs, tangents, material = square(picture)
    write_textured_glb(tmp_path / "model.glb", given, uvs, tangents, material)
    mesh = trimesh.load_mesh(tmp_path / "model.glb", process=False)
    np.testing.assert_allclose(mesh.vertices, given.vertices, atol=1e-6)
    np.testing.assert_array_equal(mesh.faces, given.faces)
    visual: Any = mesh.visual
    image = np.asarray(visual.material.baseColorTexture.convert("RGB"))
    np.testing.assert_array_equal(image, picture)
    rows, columns = 7 - (visual.uv[:, 1] * 7).astype(int), (visual.uv[:, 0] * 7).astype(int)
    np.testing.assert_array_equal(image[rows, columns], [(200, 10, 20), (0, 0, 0), (1, 2, 250), (0, 0, 0)])
    with pytest.raises(MeshError, match="uvs: expected"):
        write_textured_glb(tmp_path / "model.glb", given, uvs[:3], tangents, material)
    with pytest.raises(MeshError, match="tangents: expected"):
        write_textured_glb(tmp_path / "model.glb", given, uvs, tangents[:, :3], material)


def test_textured_glb_holds_the_material(tmp_path: Path) -> None:
    mesh, uvs, tangents, material = square(np.zeros((8, 8, 3), np.uint8))
    write_textured_glb(tmp_path / "model.glb", mesh, uvs, tangents, material)
    visual: Any = trimesh.load_mesh(tmp_path / "model.glb", process=False).visual
    read = visual.material
    assert (read.roughnessFactor, read.metallicFactor, read.doubleSided) == (0.25, 1.0, True)
    np.testing.assert_array_equal(np.asarray(read.normalTexture.convert("RGB")), np.full((4, 4, 3), (128, 128, 255)))
    np.testing.assert_array_equal(np.asarray(read.occlusionTexture.convert("L")), np.full((2, 2), 200))


def test_a_matte_surface_has_no_gloss_in_its_file(tmp_path: Path) -> None:
    """Check glTF's extension by its specification; without it, every dielectric mirrors 4%."""
    mesh, uvs, tangents, material = square(np.zeros((8, 8, 3), np.uint8))
    write_textured_glb(tmp_path / "model.glb", mesh, uvs, tangents, replace(material, metallic=0.0, glossy=False))
    data = (tmp_path / "model.glb").read_bytes()
    document = json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])
    assert document["extensionsUsed"] == ["KHR_materials_specular"]
    assert document["materials"][0]["extensions"] == {"KHR_materials_specular": {"specularFactor": 0}}
    write_textured_glb(tmp_path / "glossy.glb", mesh, uvs, tangents, material)
    assert b"KHR_materials_specular" not in (tmp_path / "glossy.glb").read_bytes()


def test_a_ply_tells_its_unit(tmp_path: Path) -> None:
    write_ply(tmp_path / "a.ply", *mesh_and_colors(*ball()), unit=0.1)
    write_ply(tmp_path / "b.ply", *mesh_and_colors(*ball()))
    assert [read_number(tmp_path / name, UNIT) for name in ("a.ply", "b.ply")] == [0.1, 1.0]
    assert len(PlyData.read(str(tmp_path / "a.ply"))["vertex"].data) == len(ball()[0])
    for text in (b"x", b"nan", b"-1", b"0"):
        (tmp_path / "c.ply").write_bytes(b"ply\ncomment mgsr unit " + text + b"\nend_header\n")
        assert read_number(tmp_path / "c.ply", UNIT) == 1


def test_glb_normals_are_unit_also_where_there_is_none(tmp_path: Path) -> None:
    vertices, faces, normals, colors = ball()
    write_glb(
        tmp_path / "mesh.glb",
        *mesh_and_colors(vertices, faces, np.vstack([np.zeros((1, 3)), 0.5 * normals[1:]]), colors),
    )
    written = trimesh.load_mesh(tmp_path / "mesh.glb", process=False).vertex_normals
    np.testing.assert_allclose(written[1:], normals[1:], atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(written[0]), 1, atol=1e-6)


@pytest.mark.parametrize(
    ("up", "top"),
    [
        (UpAxis.Y, (0, 3, 0)),
        (UpAxis.Z, (0, 0, 3)),
        (UpAxis.MINUS_Y, (0, -3, 0)),
        (UpAxis.MINUS_Z, (0, 0, -3)),
    ],
)
def test_glb_stands_upright(tmp_path: Path, up: UpAxis, top: tuple[float, float, float]) -> None:
    """Check a triangle whose third corner is its top; it stays right-handed, so its face's side follows."""
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], top])
    arrays = (vertices, np.array([[0, 1, 2]]), np.tile(np.cross([1, 0, 0], top) / 3, (3, 1)), np.ones((3, 3)))
    write_glb(tmp_path / "mesh.glb", *mesh_and_colors(*arrays), up)
    mesh = trimesh.load_scene(tmp_path / "mesh.glb", process=False).to_mesh()
    np.testing.assert_allclose(mesh.vertices, [[0, 0, 0], [1, 0, 0], [0, 3, 0]], atol=1e-6)
    np.testing.assert_allclose(mesh.face_normals, [[0, 0, 1]], atol=1e-6)


@pytest.mark.parametrize("up", [(1, 0, 0), (-1, 0, 0), (0.68, 0.09, 0.727), (0.1, -0.99, 0.1), (-0.3, 0.5, -0.8)])
def test_glb_stands_upright_for_any_direction(tmp_path: Path, up: tuple[float, float, float]) -> None:
    """Check that the node's matrix takes it to y by the shortest way, about the axis that is normal to both."""
    direction = np.array(up) / np.linalg.norm(up)
    vertices, faces, normals, colors = ball(4e6)
    write_glb(tmp_path / "mesh.glb", *mesh_and_colors(vertices, faces, normals, colors), direction)
    scene = trimesh.load_scene(tmp_path / "mesh.glb", process=False)
    pose, _ = scene.graph[next(iter(scene.graph.nodes_geometry))]
    turn = Rotation.from_matrix(pose[:3, :3])
    np.testing.assert_allclose(turn.apply(direction), [0, 1, 0], atol=1e-12)
    assert turn.magnitude() == pytest.approx(np.arccos(direction[1]))
    np.testing.assert_allclose(scene.to_mesh().vertices, turn.apply(vertices), rtol=0, atol=1e-6)


def test_glb_keeps_far_places_through_a_conversion(tmp_path: Path) -> None:
    arrays = ball(5e6)
    write_ply(tmp_path / "a.ply", *mesh_and_colors(*arrays))
    for name in ("b.glb", "c.ply", "d.obj", "e.ply"):
        before = sorted(tmp_path.iterdir())[-1]
        convert(before, tmp_path / name)
    for name in ("c.ply", "e.ply"):
        read = PlyData.read(str(tmp_path / name))["vertex"]
        np.testing.assert_allclose(np.stack([read[axis] for axis in "xyz"], 1), arrays[0], rtol=0, atol=1e-7)


def test_srgb_curve_ends() -> None:
    np.testing.assert_allclose(srgb_to_linear(np.array([0.0, 0.5, 1.0])), [0, 0.21404, 1], atol=1e-5)


@pytest.mark.parametrize("write", [write_ply, write_glb, write_obj])
def test_bad_meshes_are_refused(tmp_path: Path, write: Callable[..., Any]) -> None:
    vertices, faces, normals, colors = ball()
    with pytest.raises(MeshError, match="at least one face"):
        write(tmp_path / "mesh", *mesh_and_colors(vertices, faces[:0], normals, colors))
    with pytest.raises(MeshError, match="colors: expected"):
        write(tmp_path / "mesh", *mesh_and_colors(vertices, faces, normals, colors[:-1]))
    with pytest.raises(MeshError, match="faces: expected"):
        write(tmp_path / "mesh", *mesh_and_colors(vertices, faces + 1, normals, colors))
