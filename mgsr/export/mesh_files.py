"""Meshes as files: PLY with normals and colours, and binary glTF."""

from __future__ import annotations

import json
import struct
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np

from mgsr.data.images import srgb_to_linear
from mgsr.errors import MeshError


class UpAxis(StrEnum):
    """Which axis of the mesh's frame points up. glTF wants y; a z-up mesh gets a node that turns it."""

    Y = "y"
    Z = "z"


def write_ply(path: Path, vertices: np.ndarray, faces: np.ndarray, normals: np.ndarray, colors: np.ndarray) -> None:
    """Binary little-endian PLY: vertices [V,3], faces [F,3], unit normals [V,3], colours [V,3] sRGB 0..1 (as uchar).

    Positions are float, or double where float would lose more than a 100,000th of the mesh's size, as it does in
    frames whose origin lies far away. Raises MeshError for arrays that don't fit together.
    """
    _check(vertices, faces, normals, colors)
    real = "double" if _needs_double(vertices) else "float"
    columns = [(axis, "<f8" if real == "double" else "<f4") for axis in "xyz"]
    columns += [(name, "<f4") for name in ("nx", "ny", "nz")] + [(name, "u1") for name in ("red", "green", "blue")]
    rows = np.empty(len(vertices), columns)
    for names, values in ((("x", "y", "z"), vertices), (("nx", "ny", "nz"), normals)):
        for axis, name in enumerate(names):
            rows[name] = values[:, axis]
    for axis, name in enumerate(("red", "green", "blue")):
        rows[name] = np.rint(np.clip(colors[:, axis], 0, 1) * 255)
    corners = np.empty(len(faces), [("count", "u1"), ("index", "<i4", 3)])
    corners["count"], corners["index"] = 3, faces
    path.write_bytes(_ply_header(len(vertices), len(faces), real) + rows.tobytes() + corners.tobytes())


def _ply_header(vertex_count: int, face_count: int, real: str) -> bytes:
    lines = ["ply", "format binary_little_endian 1.0", "comment colours are sRGB", f"element vertex {vertex_count}"]
    lines += [f"property {real} {name}" for name in ("x", "y", "z")]
    lines += [f"property float {name}" for name in ("nx", "ny", "nz")]
    lines += [f"property uchar {name}" for name in ("red", "green", "blue")]
    lines += [f"element face {face_count}", "property list uchar int vertex_indices", "end_header"]
    return ("\n".join(lines) + "\n").encode("ascii")


def _needs_double(vertices: np.ndarray) -> bool:
    size = float((vertices.max(0) - vertices.min(0)).max())
    return bool(np.abs(vertices).max() * np.finfo(np.float32).eps > 1e-5 * size)


def write_glb(
    path: Path,
    vertices: np.ndarray,
    faces: np.ndarray,
    normals: np.ndarray,
    colors: np.ndarray,
    up: UpAxis = UpAxis.Y,
) -> None:
    """Binary glTF 2.0 with vertex colours, which glTF wants linear: they are converted from sRGB, and stored in 16
    bits, because 8 linear bits would band in dark scenes. The material is matte and two-sided.

    Positions are in the mesh's frame about their middle; the node puts them back (and turns z-up meshes y-up), so
    that frames with a far origin keep their precision. Arguments and errors as of `write_ply`.
    """
    _check(vertices, faces, normals, colors)
    middle = (vertices.max(0) + vertices.min(0)) / 2
    positions = (vertices - middle).astype("<f4")
    linear = np.full((len(vertices), 4), 65535, "<u2")
    linear[:, :3] = np.rint(srgb_to_linear(np.clip(colors, 0, 1)) * 65535)
    arrays = [
        (faces.astype("<u4").ravel(), "SCALAR", 5125, 34963),
        (positions, "VEC3", 5126, 34962),
        (normals.astype("<f4"), "VEC3", 5126, 34962),
        (linear, "VEC4", 5123, 34962),
    ]
    body = b"".join(array.tobytes() for array, *_ in arrays)
    path.write_bytes(_glb(_gltf(arrays, _node_matrix(middle, up)), body))


def _node_matrix(middle: np.ndarray, up: UpAxis) -> list[float]:
    """Column by column, as glTF has it."""
    matrix = np.eye(4)
    if up is UpAxis.Z:
        matrix[:3, :3] = [[1, 0, 0], [0, 0, 1], [0, -1, 0]]
    matrix[:3, 3] = matrix[:3, :3] @ middle
    return [float(value) for value in matrix.T.ravel()]


def _gltf(arrays: list[tuple[np.ndarray, str, int, int]], matrix: list[float]) -> dict[str, Any]:
    views: list[dict[str, int]] = []
    accessors: list[dict[str, Any]] = []
    start = 0
    for array, shape, component, target in arrays:
        views.append({"buffer": 0, "byteOffset": start, "byteLength": array.nbytes, "target": target})
        accessors.append({"bufferView": len(accessors), "componentType": component, "count": len(array), "type": shape})
        start += array.nbytes
    positions = arrays[1][0]
    accessors[1] |= {"min": positions.min(0).tolist(), "max": positions.max(0).tolist()}
    accessors[3]["normalized"] = True
    primitive = {"indices": 0, "attributes": {"POSITION": 1, "NORMAL": 2, "COLOR_0": 3}, "material": 0}
    return {
        "asset": {"version": "2.0", "generator": "mgsr"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "matrix": matrix}],
        "meshes": [{"primitives": [primitive]}],
        "materials": [{"pbrMetallicRoughness": {"metallicFactor": 0, "roughnessFactor": 1}, "doubleSided": True}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": start}],
    }


def _glb(document: dict[str, Any], body: bytes) -> bytes:
    text = json.dumps(document, separators=(",", ":")).encode("ascii")
    text += b" " * (-len(text) % 4)
    body += b"\0" * (-len(body) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(body), b"BIN\0") + body
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def _check(vertices: np.ndarray, faces: np.ndarray, normals: np.ndarray, colors: np.ndarray) -> None:
    if len(faces) == 0:
        raise MeshError("mesh export: expected at least one face, got none; an empty mesh is not written")
    for name, array in (("vertices", vertices), ("normals", normals), ("colors", colors)):
        if array.shape != (len(vertices), 3):
            raise MeshError(f"mesh export: {name}: expected [V={len(vertices)}, 3], got {list(array.shape)}")
    if faces.ndim != 2 or faces.shape[1] != 3 or faces.min() < 0 or faces.max() >= len(vertices):
        raise MeshError(f"mesh export: faces: expected [F, 3] indices under V={len(vertices)}, got {list(faces.shape)}")
