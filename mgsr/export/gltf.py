"""Binary glTF 2.0 of one mesh with one material."""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np

from mgsr.export.draco import DracoMesh, compress
from mgsr.geometry.mesh import Mesh

_COMPONENTS = {"<f4": 5126, "<u4": 5125}
_SHAPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}
_INDICES, _VERTICES = 34963, 34962
_DRACO, _SPECULAR, _WEBP = "KHR_draco_mesh_compression", "KHR_materials_specular", "EXT_texture_webp"


class UpAxis(StrEnum):
    """Which axis of the mesh's frame points up. glTF wants y; others get a node that turns them."""

    Y = "y"
    Z = "z"
    MINUS_Y = "-y"
    MINUS_Z = "-z"


# The up direction in the mesh's frame: an axis by its name, or any direction [3] of length 1.
UpDirection = UpAxis | np.ndarray
_DIRECTIONS = {UpAxis.Y: (0, 1, 0), UpAxis.Z: (0, 0, 1), UpAxis.MINUS_Y: (0, -1, 0), UpAxis.MINUS_Z: (0, 0, -1)}


@dataclass(frozen=True)
class PbrMaterial:
    """A physically based material; its maps are pictures of the surface by TEXCOORD_0, as the bytes of files.

    base_color: sRGB. normal: in tangent space. occlusion: its red channel is the visible share of the sky. roughness,
    metallic: 0..1 on the whole surface. glossy: False for a dielectric without the gloss that glTF gives to all.
    webp: whether the files are WebP instead of PNG.
    """

    base_color: bytes
    normal: bytes
    occlusion: bytes
    roughness: float
    metallic: float
    glossy: bool = True
    webp: bool = False


def glb(
    mesh: Mesh,
    attributes: Mapping[str, np.ndarray],
    up: UpDirection,
    material: PbrMaterial | None = None,
    compressed: bool = False,
) -> bytes:
    """Return the bytes of a binary glTF file with one mesh.

    attributes: by glTF's names, arrays [V,n] of little-endian float32. material: None for a matte one.
    compressed: compress the mesh by Draco; attributes must be NORMAL and TEXCOORD_0.

    The surface is two-sided. Positions are about the mesh's middle. The node puts them back (and turns the
    mesh y-up), so that frames with a far origin keep their precision.
    """
    vertices, faces = mesh.vertices, mesh.faces
    middle = (vertices.max(0) + vertices.min(0)) / 2
    positions = (vertices - middle).astype("<f4")
    used: list[str] = []
    body = _Body()
    if compressed:
        packed = compress(Mesh(positions, faces), attributes["NORMAL"], attributes["TEXCOORD_0"])
        primitive = _compressed_primitive(packed, body)
        used.append(_DRACO)
    else:
        indices = body.add_array(faces.astype("<u4").ravel(), _INDICES)
        places = {"POSITION": body.add_array(positions, _VERTICES)}
        body.accessors[places["POSITION"]] |= _bounds(positions)
        places |= {name: body.add_array(array, _VERTICES) for name, array in attributes.items()}
        primitive = {"indices": indices, "attributes": places}
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "mgsr"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "matrix": _node_matrix(middle, up)}],
        "meshes": [{"primitives": [primitive | {"material": 0}]}],
        "materials": [{"pbrMetallicRoughness": {"metallicFactor": 0, "roughnessFactor": 1}, "doubleSided": True}],
    }
    required = list(used)
    if material is not None:
        parts, extensions = _textured(material, body)
        document |= parts
        used += extensions
        required += [name for name in extensions if name == _WEBP]
    document |= {name: names for name, names in (("extensionsUsed", used), ("extensionsRequired", required)) if names}
    document |= {"accessors": body.accessors, "bufferViews": body.views, "buffers": [{"byteLength": len(body.data)}]}
    return glb_file(document, bytes(body.data))


class _Body:
    """The binary half of a file, with the JSON that says where its parts lie."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.views: list[dict[str, int]] = []
        self.accessors: list[dict[str, Any]] = []

    def add_bytes(self, part: bytes) -> int:
        """Append the part's bytes, and return the index of their buffer view."""
        self.data += b"\0" * (-len(self.data) % 4)
        self.views.append({"buffer": 0, "byteOffset": len(self.data), "byteLength": len(part)})
        self.data += part
        return len(self.views) - 1

    def add_array(self, array: np.ndarray, target: int) -> int:
        """Append the array [V,n] or [F,3], and return the index of its accessor."""
        view = self.add_bytes(array.tobytes())
        self.views[view]["target"] = target
        columns = 1 if array.ndim == 1 else array.shape[1]
        accessor: dict[str, Any] = {"bufferView": view, "componentType": _COMPONENTS[array.dtype.newbyteorder("<").str]}
        accessor |= {"count": len(array), "type": _SHAPES[columns]}
        self.accessors.append(accessor)
        return len(self.accessors) - 1


def _bounds(positions: np.ndarray) -> dict[str, list[float]]:
    """Return the bounds that the accessor of positions [V,3] must state."""
    return {"min": positions.min(0).tolist(), "max": positions.max(0).tolist()}


def _compressed_primitive(packed: DracoMesh, body: _Body) -> dict[str, Any]:
    """Append a compressed mesh, and return its primitive, whose accessors have no bytes of their own."""
    view = body.add_bytes(packed.data)
    places = {}
    for name, array in packed.decoded.items():
        places[name] = len(body.accessors)
        accessor = {"componentType": _COMPONENTS["<f4"], "count": len(array), "type": _SHAPES[array.shape[1]]}
        body.accessors.append(accessor | (_bounds(array) if name == "POSITION" else {}))
    indices = len(body.accessors)
    body.accessors.append({"componentType": _COMPONENTS["<u4"], "count": 3 * packed.faces, "type": "SCALAR"})
    extension = {"bufferView": view, "attributes": dict(packed.ids)}
    return {"indices": indices, "attributes": places, "extensions": {_DRACO: extension}}


def _textured(material: PbrMaterial, body: _Body) -> tuple[dict[str, Any], list[str]]:
    """Append a material's pictures; return the parts of the document that refer to them, and the extensions used."""
    linear, mipmaps, clamped = 9729, 9987, 33071
    views = [body.add_bytes(picture) for picture in (material.base_color, material.normal, material.occlusion)]
    surface = {
        "metallicFactor": material.metallic,
        "roughnessFactor": material.roughness,
        "baseColorTexture": {"index": 0},
    }
    maps = {"normalTexture": {"index": 1}, "occlusionTexture": {"index": 2}}
    whole: dict[str, Any] = {"pbrMetallicRoughness": surface, **maps, "doubleSided": True}
    used = []
    if not material.glossy:
        whole["extensions"] = {_SPECULAR: {"specularFactor": 0}}
        used.append(_SPECULAR)
    sources: list[dict[str, Any]] = [{"source": source} for source in range(3)]
    if material.webp:
        sources = [{"extensions": {_WEBP: source}} for source in sources]
        used.append(_WEBP)
    parts = {
        "materials": [whole],
        "textures": [{**source, "sampler": 0} for source in sources],
        "images": [{"bufferView": view, "mimeType": f"image/{'webp' if material.webp else 'png'}"} for view in views],
        "samplers": [{"magFilter": linear, "minFilter": mipmaps, "wrapS": clamped, "wrapT": clamped}],
    }
    return parts, used


def _node_matrix(middle: np.ndarray, up: UpDirection) -> list[float]:
    """Return the node's matrix as 16 numbers in column-major order, as in glTF; middle [3]."""
    matrix = np.eye(4)
    matrix[:3, :3] = turn_upright(up)
    matrix[:3, 3] = matrix[:3, :3] @ middle
    return [float(value) for value in matrix.T.ravel()]


def turn_upright(up: UpDirection) -> np.ndarray:
    """Return the shortest rotation [3,3] that takes `up` to y; the half turn about x where `up` points down.

    Source: Rodrigues' formula for the axis up x y, without the angle.
    """
    x, y, z = np.array(_DIRECTIONS[up] if isinstance(up, UpAxis) else up, np.float64)
    if y < -1 + 1e-9:
        return np.diag([1.0, -1, -1])
    # The matrix of the cross product with up x y = (-z, 0, x).
    cross = np.array([[0, -x, 0], [x, 0, z], [0, -z, 0]])
    # Adding 0 takes the sign off negative zeros.
    return np.asarray(np.eye(3) + cross + cross @ cross / (1 + y)) + 0.0


def glb_file(document: dict[str, Any], body: bytes) -> bytes:
    """Return a .glb file's bytes from glTF's JSON and its binary buffer."""
    text = json.dumps(document, separators=(",", ":")).encode("ascii")
    text += b" " * (-len(text) % 4)
    body += b"\0" * (-len(body) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(body), b"BIN\0") + body
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks
