"""Read meshes of other programs with trimesh: PLY, binary glTF and OBJ."""

from __future__ import annotations

import io
import json
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mgsr.data.images import linear_to_srgb, srgb_to_linear
from mgsr.errors import MeshError, in_short
from mgsr.export.gltf import glb_file
from mgsr.geometry.mesh import Mesh

# Extensions that do not affect the data read here.
_KNOWN_EXTENSIONS = {"KHR_materials_unlit"}
_FLOAT = 5126
_GREY = 0.5


@dataclass(frozen=True, eq=False)
class StoredMesh(Mesh):
    """A mesh of a file, with its normals; colors [V,3] sRGB 0..1."""

    colors: np.ndarray


@dataclass(frozen=True)
class _Material:
    """What glTF multiplies colours with, linear [3] or None, and whether it has a picture."""

    factor: np.ndarray | None
    pictured: bool


def load_mesh(path: Path) -> StoredMesh:
    """Load a mesh of any kind that trimesh reads, its parts in one; it is grey where it has no colours.

    glTF's vertex colours, pictures and factors are multiplied, as the format says. Of OBJ's vertex colours, picture and
    Kd, the first that exists counts.

    Raises MeshError naming the file, also for what glTF allows and trimesh does not read.
    """
    try:
        parts = _read_parts(path)
    except MeshError:
        raise
    except Exception as error:  # trimesh's readers raise whatever their formats' libraries do
        raise MeshError(f"{path}: this file is not a readable mesh: {in_short(error)}; export it again") from error
    if not parts:
        raise MeshError(f"{path}: expected a mesh with faces, got none; export its faces too")
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    mesh = StoredMesh(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.faces + start for part, start in zip(parts, starts, strict=False)]),
        np.concatenate([part.colors for part in parts]),
    )
    return mesh.with_normals(np.concatenate([part.normals for part in parts]))


def _read_parts(path: Path) -> list[StoredMesh]:
    import trimesh  # imported here, because splats need no trimesh

    materials: list[_Material] = []
    if path.suffix.lower() == ".gltf":
        raise MeshError(
            f"{path}: MGSR does not read .gltf; convert it, for example with `gltf-transform copy A.gltf B.glb`"
        )
    if path.suffix.lower() == ".glb":
        data, materials = _plain_glb(path)
        scene: Any = trimesh.load_scene(io.BytesIO(data), file_type="glb", process=False)
    else:
        scene = trimesh.load_scene(path, process=False)
    nodes = [scene.graph[node] for node in scene.graph.nodes_geometry]
    found = [(pose, scene.geometry[name]) for pose, name in nodes]
    return [_part(pose, mesh, path, materials) for pose, mesh in found if len(getattr(mesh, "faces", ()))]


def _part(pose: np.ndarray, mesh: Any, path: Path, materials: list[_Material]) -> StoredMesh:
    """Return one part of a file, transformed by its node's pose [4,4]. A mirroring pose flips the faces.

    Raises MeshError where vertices are NaN or infinite.
    """
    bad = int((~np.isfinite(mesh.vertices).all(axis=1)).sum())
    if bad:
        raise MeshError(
            f"{path}: {bad} of {len(mesh.vertices)} vertices are NaN or infinite; remove them and export the mesh again"
        )
    vertices = np.asarray(mesh.vertices) @ pose[:3, :3].T + pose[:3, 3]
    normals = np.asarray(mesh.vertex_normals) @ np.linalg.inv(pose[:3, :3])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    faces = np.asarray(mesh.faces)
    if np.linalg.det(pose[:3, :3]) < 0:
        faces = faces[:, ::-1]
    colors = _gltf_colors(mesh, path, materials) if materials else _colors(mesh)
    return StoredMesh(vertices, faces, colors).with_normals(normals)


def _colors(mesh: Any) -> np.ndarray:
    """Return vertex colours [V,3], sRGB 0..1; trimesh keeps OBJ's vertex colours beside its material."""
    material = getattr(mesh.visual, "material", None)
    if mesh.visual.kind == "vertex":
        return _fractions(mesh.visual.vertex_colors)
    if "color" in mesh.vertex_attributes:
        return _fractions(mesh.vertex_attributes["color"])
    picture = _picture_colors(mesh, getattr(material, "image", None))
    if picture is not None:
        return picture
    diffuse = getattr(material, "diffuse", None)
    if diffuse is not None:
        return np.tile(_fractions(diffuse[None]), (len(mesh.vertices), 1))
    return np.full((len(mesh.vertices), 3), _GREY)


def _gltf_colors(mesh: Any, path: Path, materials: list[_Material]) -> np.ndarray:
    """Return the vertex colours [V,3], sRGB 0..1, of a part; its material's name is the part's number.

    Raises MeshError where its picture can't be read.
    """
    material = materials[int(mesh.visual.material.name)]
    picture = _picture_colors(mesh, mesh.visual.material.baseColorTexture)
    stored = mesh.visual.vertex_attributes.get("color")
    if material.pictured and picture is None and mesh.visual.uv is not None:
        raise MeshError(f"{path}: one of its images cannot be read; export it with PNG or JPEG images")
    if stored is None and picture is None and material.factor is None:
        return np.full((len(mesh.vertices), 3), _GREY)
    linear = np.ones((len(mesh.vertices), 3))
    for factor in (
        None if stored is None else _fractions(stored),
        None if picture is None else srgb_to_linear(picture),
        material.factor,
    ):
        linear *= 1 if factor is None else factor
    return linear_to_srgb(np.clip(linear, 0, 1))


def _picture_colors(mesh: Any, picture: Any) -> np.ndarray | None:
    """Return the vertices' colours [V,3] 0..1 in a texture, None without texture coordinates."""
    from trimesh.visual.color import uv_to_color

    colors = uv_to_color(getattr(mesh.visual, "uv", None), picture)
    return None if colors is None else _fractions(colors)


def _fractions(stored: np.ndarray) -> np.ndarray:
    """Return colours [V,3] in 0..1 of integers over their range, or of floats."""
    colors = np.asarray(stored)[:, :3]
    return colors / np.iinfo(colors.dtype).max if colors.dtype.kind == "u" else np.clip(colors, 0, 1)


def _plain_glb(path: Path) -> tuple[bytes, list[_Material]]:
    """Return the file with a material for each part, named by its number, and the materials' factors.

    The new materials hold only the picture: beside a picture, trimesh keeps vertex colours as they are stored. Raises
    MeshError for what trimesh would read wrongly.
    """
    document, body = _glb_chunks(path)
    unknown = set(document.get("extensionsRequired", ())) - _KNOWN_EXTENSIONS
    if unknown:
        raise MeshError(
            f"{path}: it requires {', '.join(sorted(unknown))}, which MGSR does not read; export it without "
            "compression and extensions, for example with `gltf-transform dequantize`"
        )
    given = [material.get("pbrMetallicRoughness", {}) for material in document.get("materials", ())] + [{}]
    for mesh in document.get("meshes", ()):
        for primitive in mesh["primitives"]:
            primitive.setdefault("material", len(given) - 1)
            _check_uvs(path, document, primitive, given[primitive["material"]])
    pictures = [{"baseColorTexture": pbr["baseColorTexture"]} if "baseColorTexture" in pbr else {} for pbr in given]
    document["materials"] = [
        {"name": str(number), "pbrMetallicRoughness": picture} for number, picture in enumerate(pictures)
    ]
    factors = [np.array(pbr["baseColorFactor"][:3]) if "baseColorFactor" in pbr else None for pbr in given]
    materials = [_Material(factor, bool(picture)) for factor, picture in zip(factors, pictures, strict=True)]
    return glb_file(document, body), materials


def _glb_chunks(path: Path) -> tuple[dict[str, Any], bytes]:
    data = path.read_bytes()
    if data[:4] != b"glTF" or data[4:8] != struct.pack("<I", 2) or data[16:20] != b"JSON":
        raise MeshError(f"{path}: expected binary glTF 2.0, got {len(data)} bytes of another format; export it again")
    end = 20 + int.from_bytes(data[12:16], "little")
    if int.from_bytes(data[8:12], "little") > len(data):
        raise MeshError(
            f"{path}: the file is truncated: its header announces more than its {len(data)} bytes; export it again"
        )
    return json.loads(data[20:end]), data[end + 8 :]


def _check_uvs(path: Path, document: dict[str, Any], primitive: dict[str, Any], pbr: dict[str, Any]) -> None:
    texture, place = pbr.get("baseColorTexture"), primitive["attributes"].get("TEXCOORD_0")
    if texture is None:
        return
    if texture.get("texCoord") or "KHR_texture_transform" in texture.get("extensions", {}):
        raise MeshError(f"{path}: a texture uses other coordinates than TEXCOORD_0; export it with one UV map")
    if place is not None and document["accessors"][place]["componentType"] != _FLOAT:
        raise MeshError(f"{path}: expected float values in TEXCOORD_0; export it without compression")
