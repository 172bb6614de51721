"""The compressed model, read back by Draco's own decoder; its maps by Pillow."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import DracoPy
import numpy as np
import pytest
import trimesh
from PIL import Image
from scipy.spatial import cKDTree

from mgsr.errors import MgsrError
from mgsr.export import draco
from mgsr.export.gltf import PbrMaterial, UpAxis
from mgsr.export.mesh_files import webp_bytes, write_compressed_glb, write_textured_glb
from mgsr.geometry.mesh import Mesh


def ball() -> tuple[Mesh, np.ndarray]:
    """Return a ball far from the origin, and texture coordinates [V,2]."""
    shape = trimesh.creation.icosphere(5)
    normals = np.asarray(shape.vertices)
    uvs = np.stack([np.arctan2(normals[:, 1], normals[:, 0]) / 7 + 0.5, normals[:, 2] / 2 + 0.5], axis=1)
    mesh = Mesh(3 * normals + (10, 20, 30), np.asarray(shape.faces, np.int64)).with_normals(normals.astype(np.float32))
    return mesh, uvs.astype(np.float32)


def material() -> PbrMaterial:
    """Return a material of noise, the colour's sides smooth."""
    rows, columns = np.mgrid[:64, :64]
    color = np.stack([4 * rows, 4 * columns, 2 * (rows + columns)], axis=-1).astype(np.uint8)
    normal = np.random.default_rng(0).integers(0, 256, (64, 64, 3), dtype=np.uint8)
    maps = webp_bytes(color, 90), webp_bytes(normal, 101), webp_bytes(normal[..., 0], 101)
    return PbrMaterial(*maps, roughness=0.25, metallic=0.0, glossy=False, webp=True)


def parts(path: Path) -> tuple[dict[str, Any], bytes]:
    """Return the JSON and the binary half of a .glb file."""
    data = path.read_bytes()
    length = int.from_bytes(data[12:16], "little")
    return json.loads(data[20 : 20 + length]), data[28 + length :]


def slice_of(document: dict[str, Any], body: bytes, view: int) -> bytes:
    found = document["bufferViews"][view]
    return body[found["byteOffset"] : found["byteOffset"] + found["byteLength"]]


def test_a_reader_gets_the_mesh(tmp_path: Path) -> None:
    """Check positions to half a step of 14 bits, normals to a degree, texture coordinates, and the accessors."""
    mesh, uvs = ball()
    write_compressed_glb(tmp_path / "small.glb", mesh, uvs, material(), UpAxis.Y)
    document, body = parts(tmp_path / "small.glb")
    (primitive,) = document["meshes"][0]["primitives"]
    extension = primitive["extensions"]["KHR_draco_mesh_compression"]
    found = DracoPy.decode(slice_of(document, body, extension["bufferView"]))
    read = {name: found.get_attribute_by_unique_id(number)["data"] for name, number in extension["attributes"].items()}
    moved = np.array(document["nodes"][0]["matrix"]).reshape(4, 4).T
    placed = read["POSITION"] @ moved[:3, :3].T + moved[:3, 3]
    away, nearest = cKDTree(mesh.vertices).query(placed)
    assert len(placed) == len(mesh.vertices) and len(set(nearest)) == len(nearest) and away.max() < 6 / 2**14
    assert (read["NORMAL"] * mesh.normals[nearest]).sum(axis=1).min() > np.cos(np.radians(1))
    np.testing.assert_allclose(read["TEXCOORD_0"], uvs[nearest], atol=1 / 2**14)
    assert sorted(map(sorted, nearest[found.faces].tolist())) == sorted(map(sorted, mesh.faces.tolist()))
    accessors = document["accessors"]
    assert accessors[primitive["indices"]]["count"] == found.faces.size
    assert all(accessors[place]["count"] == len(placed) for place in primitive["attributes"].values())
    bounds = accessors[primitive["attributes"]["POSITION"]]
    np.testing.assert_allclose([bounds["min"], bounds["max"]], [read["POSITION"].min(0), read["POSITION"].max(0)])
    assert not any("bufferView" in accessor for accessor in accessors), "the bytes are Draco's"


def test_the_maps_are_webp_and_the_extensions_are_named(tmp_path: Path) -> None:
    mesh, uvs = ball()
    write_compressed_glb(tmp_path / "small.glb", mesh, uvs, material(), UpAxis.Y)
    document, body = parts(tmp_path / "small.glb")
    required = ["KHR_draco_mesh_compression", "EXT_texture_webp"]
    assert document["extensionsRequired"] == required
    assert sorted(document["extensionsUsed"]) == sorted([*required, "KHR_materials_specular"])
    sources = [texture["extensions"]["EXT_texture_webp"]["source"] for texture in document["textures"]]
    images = [document["images"][source] for source in sources]
    assert {image["mimeType"] for image in images} == {"image/webp"}
    color, normal, _ = (Image.open(io.BytesIO(slice_of(document, body, image["bufferView"]))) for image in images)
    assert color.format == "WEBP" and np.array(color.convert("RGB"))[40, 10, 0] == pytest.approx(160, abs=8)
    exact = np.random.default_rng(0).integers(0, 256, (64, 64, 3), dtype=np.uint8)
    np.testing.assert_array_equal(np.array(normal.convert("RGB")), exact)


def test_it_is_much_smaller(tmp_path: Path) -> None:
    mesh, uvs = ball()
    tangents = np.tile(np.array([1.0, 0, 0, 1], np.float32), (len(uvs), 1))
    write_compressed_glb(tmp_path / "small.glb", mesh, uvs, material(), UpAxis.Y)
    write_textured_glb(tmp_path / "large.glb", mesh, uvs, tangents, replace(material(), webp=False), UpAxis.Y)
    assert (tmp_path / "small.glb").stat().st_size < 0.2 * (tmp_path / "large.glb").stat().st_size


def test_without_the_package_the_message_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(draco, "find_spec", lambda name: None)
    with pytest.raises(MgsrError, match=r"pip install 'mgsr\[draco\]'"):
        draco.require_draco()
