"""Meshes as other programs write them: squares whose colours and places follow from glTF's and OBJ's rules by hand."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from mgsr.data.images import linear_to_srgb, srgb_to_linear
from mgsr.errors import MeshError
from mgsr.export.gltf import glb_file
from mgsr.export.mesh_reading import load_mesh

CORNERS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], "<f4")
FACES = np.array([0, 1, 2, 0, 2, 3], "<u2")
UVS = np.array([[0.05, 0.05], [0.95, 0.05], [0.95, 0.95], [0.05, 0.95]], "<f4")
TEXELS = np.array([[[200, 10, 20], [30, 220, 40]], [[1, 2, 250], [120, 130, 140]]], np.uint8)
AT_CORNERS = TEXELS[[0, 0, 1, 1], [0, 1, 1, 0]] / 255
COMPONENTS = {"u1": 5121, "u2": 5123, "f4": 5126}
FACTOR = (0.5, 0.25, 1.0, 1.0)
SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"


def write_square(
    path: Path, attributes: dict[str, np.ndarray], material: dict[str, Any] | None = None, **document: Any
) -> None:
    """Write a glb of a square with a picture, by glTF's specification."""
    png = io.BytesIO()
    Image.fromarray(TEXELS).save(png, "PNG")
    arrays = [FACES, CORNERS, *attributes.values()]
    parts = [array.tobytes() for array in arrays] + [png.getvalue()]
    body, views = b"", []
    for part in parts:
        body += bytes(-len(body) % 4)
        views.append({"buffer": 0, "byteOffset": len(body), "byteLength": len(part)})
        body += part
    accessors = [
        {
            "bufferView": view,
            "componentType": COMPONENTS[array.dtype.str[1:]],
            "count": len(array),
            "type": "SCALAR" if array.ndim == 1 else f"VEC{array.shape[1]}",
            "normalized": name not in ("indices", "POSITION") and array.dtype.kind == "u",
        }
        for view, (name, array) in enumerate(zip(("indices", "POSITION", *attributes), arrays, strict=True))
    ]
    primitive: dict[str, Any] = {"indices": 0, "attributes": {"POSITION": 1}}
    primitive["attributes"] |= {name: 2 + place for place, name in enumerate(attributes)}
    if material is not None:
        document["materials"] = [{"pbrMetallicRoughness": material}]
        primitive["material"] = 0
    whole = {"asset": {"version": "2.0"}, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}], "accessors": accessors}
    whole |= {"bufferViews": views, "buffers": [{"byteLength": len(body)}], "meshes": [{"primitives": [primitive]}]}
    whole |= {"images": [{"bufferView": len(parts) - 1, "mimeType": "image/png"}], "textures": [{"source": 0}]}
    path.write_bytes(glb_file(whole | document, body))


COLORS = np.array([[0, 64, 255, 255], [128, 128, 128, 255], [10, 0, 0, 255], [255, 255, 255, 255]], np.uint8)


@pytest.mark.parametrize(
    "stored",
    [
        pytest.param(COLORS, id="bytes"),
        pytest.param(COLORS.astype("<u2") * 257, id="16 bits"),
        pytest.param((COLORS / 255).astype("<f4"), id="floats"),
        pytest.param((COLORS[:, :3] / 255).astype("<f4"), id="without alpha"),
    ],
)
@pytest.mark.parametrize("factor", [None, FACTOR])
@pytest.mark.parametrize("pictured", [False, True])
def test_gltf_multiplies_linear_colours(
    tmp_path: Path, stored: np.ndarray, factor: tuple[float, float, float, float] | None, pictured: bool
) -> None:
    attributes = {"COLOR_0": stored} | ({"TEXCOORD_0": UVS} if pictured else {})
    material: dict[str, Any] = {} if factor is None else {"baseColorFactor": list(factor)}
    material |= {"baseColorTexture": {"index": 0}} if pictured else {}
    write_square(tmp_path / "a.glb", attributes, material or None)
    linear = COLORS[:, :3] / 255
    linear = linear * (np.ones(3) if factor is None else factor[:3]) * (srgb_to_linear(AT_CORNERS) if pictured else 1)
    np.testing.assert_allclose(load_mesh(tmp_path / "a.glb").colors, linear_to_srgb(linear), atol=1e-5)


def test_gltf_without_vertex_colours(tmp_path: Path) -> None:
    write_square(tmp_path / "factor.glb", {}, {"baseColorFactor": [0.21404, 0.0, 1.0, 1.0]})
    np.testing.assert_allclose(load_mesh(tmp_path / "factor.glb").colors, [[0.5, 0, 1]] * 4, atol=1e-4)
    write_square(tmp_path / "picture.glb", {"TEXCOORD_0": UVS}, {"baseColorTexture": {"index": 0}})
    np.testing.assert_allclose(load_mesh(tmp_path / "picture.glb").colors, AT_CORNERS, atol=1e-5)
    for name, attributes, material in (("none", {}, None), ("uvs", {"TEXCOORD_0": UVS}, {"roughnessFactor": 1.0})):
        write_square(tmp_path / f"{name}.glb", attributes, material)
        np.testing.assert_allclose(load_mesh(tmp_path / f"{name}.glb").colors, 0.5)


def test_mirrored_nodes_keep_the_outside_outside(tmp_path: Path) -> None:
    write_square(
        tmp_path / "a.glb",
        {"NORMAL": np.tile(np.array([[0, 0, 1]], np.float32), (4, 1))},
        nodes=[{"mesh": 0, "scale": [-2, 1, 1]}],
    )
    mesh = load_mesh(tmp_path / "a.glb")
    np.testing.assert_allclose(mesh.vertices, CORNERS * [-2, 1, 1])
    a, b, c = mesh.vertices[mesh.faces[0]]
    np.testing.assert_allclose(np.cross(b - a, c - a), [0, 0, 2])
    np.testing.assert_allclose(mesh.normals, [[0, 0, 1]] * 4)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (
            {"extensionsRequired": ["KHR_mesh_quantization"]},
            "requires KHR_mesh_quantization, .*`gltf-transform dequantize`",
        ),
        ({"extensionsRequired": ["EXT_meshopt_compression", "KHR_draco_mesh_compression"]}, "EXT_meshopt.*, KHR_draco"),
        ({"material": {"baseColorTexture": {"index": 0, "texCoord": 1}}}, "other coordinates than TEXCOORD_0"),
        (
            {
                "material": {
                    "baseColorTexture": {"index": 0, "extensions": {"KHR_texture_transform": {"scale": [2, 2]}}}
                }
            },
            "other coordinates than TEXCOORD_0",
        ),
        (
            {"uvs": (UVS * 65535).astype("<u2"), "material": {"baseColorTexture": {"index": 0}}},
            "expected float values in TEXCOORD_0",
        ),
        (
            {"images": [{"bufferView": 0, "mimeType": "image/png"}]},
            "one of its images cannot be read; export it with PNG",
        ),
    ],
)
def test_gltf_that_is_refused(
    tmp_path: Path,
    given: dict[str, Any],
    message: str,
) -> None:
    document: dict[str, Any] = {"material": {"baseColorTexture": {"index": 0}}, "uvs": UVS} | given
    write_square(tmp_path / "a.glb", {"TEXCOORD_0": document.pop("uvs")}, document.pop("material"), **document)
    with pytest.raises(MeshError, match=rf"a\.glb: .*{message}"):
        load_mesh(tmp_path / "a.glb")


@pytest.mark.parametrize(
    ("obj", "mtl", "expected"),
    [
        pytest.param("usemtl a\nf 1 2 3 4\n", "newmtl a\nKd 1 0 0.4\n", [[1, 0, 0.4]] * 4, id="Kd"),
        pytest.param("usemtl a\nf 1 2 3 4\n", None, [[0.5, 0.5, 0.5]] * 4, id="mtl missing"),
        pytest.param("vt 0 0\nf 1/1 2/1 3/1 4/1\n", None, None, id="uvs only"),
        pytest.param("vt 0 0\nusemtl a\nf 1/1 2/1 3/1 4/1\n", None, None, id="uvs, mtl missing"),
        pytest.param(
            "vt 0 0\nusemtl a\nf 1/1 2/1 3/1 4/1\n", "newmtl a\nKd 1 0 0.4\n", [[1, 0, 0.4]] * 4, id="no picture"
        ),
        pytest.param(
            "vt .05 .95\nvt .95 .95\nvt .95 .05\nvt .05 .05\nusemtl a\nf 1/1 2/2 3/3 4/4\n",
            "newmtl a\nKd 0.8 0.8 0.8\nmap_Kd a.png\n",
            AT_CORNERS,
            id="picture",
        ),
    ],
)
def test_obj_materials(
    tmp_path: Path, obj: str, mtl: str | None, expected: list[list[float]] | np.ndarray | None
) -> None:
    Image.fromarray(TEXELS).save(tmp_path / "a.png")
    (tmp_path / "a.obj").write_text(f"mtllib a.mtl\n{SQUARE}{obj}")
    if mtl is not None:
        (tmp_path / "a.mtl").write_text(mtl)
    colors = load_mesh(tmp_path / "a.obj").colors
    assert colors.shape == (4, 3) and (colors >= 0).all() and (colors <= 1).all()
    if expected is not None:
        np.testing.assert_allclose(colors, expected, atol=0.51 / 255)


def test_obj_vertex_colours_count_before_materials(tmp_path: Path) -> None:
    lines = "v 0 0 0 1 0 0\nv 1 0 0 0 .5 0\nv 1 1 0 0 0 .25\n"
    (tmp_path / "a.mtl").write_text("newmtl a\nKd 0.8 0.8 0.8\n")
    (tmp_path / "a.obj").write_text(f"mtllib a.mtl\n{lines}usemtl a\nf 1 2 3\n")
    np.testing.assert_allclose(load_mesh(tmp_path / "a.obj").colors, np.diag([1, 0.5, 0.25]), atol=1e-6)


@pytest.mark.parametrize("number", ["nan", "1e400"])
def test_vertices_without_a_place(tmp_path: Path, number: str) -> None:
    (tmp_path / "a.obj").write_text(f"v {number} 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 3\n")
    with pytest.raises(MeshError, match=r"a\.obj: 1 of 3 vertices are NaN or infinite; remove them"):
        load_mesh(tmp_path / "a.obj")


@pytest.mark.parametrize(
    ("name", "data", "message"),
    [
        ("a.glb", b"", "expected binary glTF 2.0, got 0 bytes"),
        ("a.glb", b"glTF" + bytes(40), "expected binary glTF 2.0"),
        ("a.gltf", b"{}", "MGSR does not read \\.gltf; convert it"),
        ("a.ply", b"", "this file is not a readable mesh: .*; export it again"),
        ("a.obj", b"v 0 0 0\n", "expected a mesh with faces, got none"),
    ],
)
def test_files_that_are_no_meshes(tmp_path: Path, name: str, data: bytes, message: str) -> None:
    (tmp_path / name).write_bytes(data)
    with pytest.raises(MeshError, match=f"{name}: {message}"):
        load_mesh(tmp_path / name)


def test_a_cut_off_glb(tmp_path: Path) -> None:
    write_square(tmp_path / "a.glb", {})
    (tmp_path / "a.glb").write_bytes((tmp_path / "a.glb").read_bytes()[:-1])
    with pytest.raises(MeshError, match=r"a\.glb: the file is truncated"):
        load_mesh(tmp_path / "a.glb")
