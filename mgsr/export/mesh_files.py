"""Meshes as files: PLY with normals and colours, and binary glTF."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mgsr.data.images import srgb_to_linear
from mgsr.errors import MeshError
from mgsr.export.gltf import PbrMaterial, UpAxis, UpDirection, glb
from mgsr.export.ply_notes import number_comments
from mgsr.geometry.mesh import Mesh
from mgsr.geometry.precision import box, float_is_too_coarse


def check_mesh(mesh: Mesh, **attributes: np.ndarray) -> None:
    """Raise MeshError for a mesh without faces, and for arrays that don't fit together.

    attributes [V,3]: beside its normals.
    """
    vertices, faces = mesh.vertices, mesh.faces
    if len(faces) == 0:
        raise MeshError("mesh export: expected at least one face, got none")
    if faces.ndim != 2 or faces.shape[1] != 3 or faces.min() < 0 or faces.max() >= len(vertices):
        raise MeshError(f"mesh export: faces: expected indices [F, 3] below V={len(vertices)}, got {list(faces.shape)}")
    for name, array in {"vertices": vertices, "normals": mesh.normals, **attributes}.items():
        if array.shape != (len(vertices), 3):
            raise MeshError(f"mesh export: {name}: expected [V={len(vertices)}, 3], got {list(array.shape)}")


def write_ply(path: Path, mesh: Mesh, colors: np.ndarray, unit: float = 1.0) -> None:
    """Write a mesh as binary little-endian PLY.

    mesh: with its normals. colors: [V,3] sRGB 0..1, stored as uchar. unit: the factor of the lengths, for the header.

    Positions are float, or double where float would lose more than a 100,000th of the mesh's size, as far from the
    frame's origin. Raises MeshError for arrays that don't fit together.
    """
    check_mesh(mesh, colors=colors)
    vertices, faces = mesh.vertices, mesh.faces
    real = "double" if float_is_too_coarse(*box(vertices)) else "float"
    columns = [(axis, "<f8" if real == "double" else "<f4") for axis in "xyz"]
    columns += [(name, "<f4") for name in ("nx", "ny", "nz")] + [(name, "u1") for name in ("red", "green", "blue")]
    rows = np.empty(len(vertices), columns)
    for names, values in ((("x", "y", "z"), vertices), (("nx", "ny", "nz"), mesh.normals)):
        for axis, name in enumerate(names):
            rows[name] = values[:, axis]
    for axis, name in enumerate(("red", "green", "blue")):
        rows[name] = np.rint(np.clip(colors[:, axis], 0, 1) * 255)
    corners = np.empty(len(faces), [("count", "u1"), ("index", "<i4", 3)])
    corners["count"], corners["index"] = 3, faces
    path.write_bytes(_ply_header(len(vertices), len(faces), real, unit) + rows.tobytes() + corners.tobytes())


def _ply_header(vertex_count: int, face_count: int, real: str, unit: float) -> bytes:
    lines = ["ply", "format binary_little_endian 1.0", "comment colours are sRGB"]
    lines += [f"comment {text}" for text in number_comments(unit=unit)] + [f"element vertex {vertex_count}"]
    lines += [f"property {real} {name}" for name in ("x", "y", "z")]
    lines += [f"property float {name}" for name in ("nx", "ny", "nz")]
    lines += [f"property uchar {name}" for name in ("red", "green", "blue")]
    lines += [f"element face {face_count}", "property list uchar int vertex_indices", "end_header"]
    return ("\n".join(lines) + "\n").encode("ascii")


def write_glb(path: Path, mesh: Mesh, colors: np.ndarray, up: UpDirection = UpAxis.Y) -> None:
    """Write a mesh with vertex colours as binary glTF 2.0.

    colors [V,3] sRGB 0..1 are converted to linear, as glTF requires. They are stored as float32: 8 linear bits would
    band in dark scenes, and MeshLab reads 16 as noise. See `glb`; arguments and errors as of `write_ply`.
    """
    check_mesh(mesh, colors=colors)
    linear = np.ones((len(mesh.vertices), 4), "<f4")
    linear[:, :3] = srgb_to_linear(np.clip(colors, 0, 1))
    path.write_bytes(glb(mesh, {"NORMAL": unit_normals(mesh.normals), "COLOR_0": linear}, up))


def write_textured_glb(
    path: Path, mesh: Mesh, uvs: np.ndarray, tangents: np.ndarray, material: PbrMaterial, up: UpDirection = UpAxis.Y
) -> None:
    """Write a mesh with a textured material as binary glTF 2.0.

    uvs: [V,2] in 0..1 from the upper left corner of the material's pictures. tangents: [V,4], unit, with the sign of
    the bitangent. See `glb`; the other arguments and errors as of `write_ply`.

    Raises MeshError if uvs or tangents have another shape.
    """
    check_mesh(mesh)
    for name, array, columns in (("uvs", uvs, 2), ("tangents", tangents, 4)):
        if array.shape != (len(mesh.vertices), columns):
            expected = f"[V={len(mesh.vertices)}, {columns}]"
            raise MeshError(f"mesh export: {name}: expected {expected}, got {list(array.shape)}")
    attributes = {
        "NORMAL": unit_normals(mesh.normals),
        "TANGENT": tangents.astype("<f4"),
        "TEXCOORD_0": uvs.astype("<f4"),
    }
    path.write_bytes(glb(mesh, attributes, up, material))


def write_compressed_glb(
    path: Path, mesh: Mesh, uvs: np.ndarray, material: PbrMaterial, up: UpDirection = UpAxis.Y
) -> None:
    """Write a mesh with a textured material as binary glTF 2.0, compressed by Draco.

    It has no tangents: readers compute them by MikkTSpace, as glTF asks. uvs [V,2], and the other arguments and errors
    as of `write_textured_glb`.

    Raises MgsrError if DracoPy is not installed.
    """
    check_mesh(mesh)
    attributes = {"NORMAL": unit_normals(mesh.normals), "TEXCOORD_0": uvs.astype("<f4")}
    path.write_bytes(glb(mesh, attributes, up, material, compressed=True))


def webp_bytes(picture: np.ndarray, quality: int) -> bytes:
    """Return a picture [H,W] or [H,W,3] uint8 as the bytes of a WebP file; quality: 1..100, above 100 lossless."""
    import cv2  # imported here, because training needs no OpenCV

    return _encoded(picture, ".webp", [cv2.IMWRITE_WEBP_QUALITY, quality])


def png_bytes(picture: np.ndarray) -> bytes:
    """Return a picture [H,W] or [H,W,3] uint8 as the bytes of a PNG file."""
    return _encoded(picture, ".png", [])


def _encoded(picture: np.ndarray, kind: str, parameters: list[int]) -> bytes:
    """Return a picture [H,W] or [H,W,3] uint8 as the bytes of a file whose name ends in `kind`."""
    import cv2  # imported here, because training needs no OpenCV

    shown = np.ascontiguousarray(picture[..., ::-1] if picture.ndim == 3 else picture)
    _, data = cv2.imencode(kind, shown, parameters)
    return data.tobytes()


def unit_normals(normals: np.ndarray) -> np.ndarray:
    """Return unit normals [V,3], little-endian float32; (0, 0, 1) where folded faces leave none."""
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.where(lengths > 1e-6, normals / np.maximum(lengths, 1e-6), [[0.0, 0.0, 1.0]]).astype("<f4")
