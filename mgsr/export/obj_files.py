"""Meshes as Wavefront OBJ, for programs that read nothing newer."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mgsr.export.mesh_files import check_mesh
from mgsr.geometry.mesh import Mesh
from mgsr.geometry.precision import box, float_is_too_coarse


def write_obj(path: Path, mesh: Mesh, colors: np.ndarray) -> None:
    """Write a mesh as a Wavefront OBJ file.

    mesh: with its normals. colors: [V,3] sRGB 0..1, written behind the vertices (an extension that MeshLab, Blender and
    others read). Positions have twelve digits, or fifteen where float32 would be too coarse. Colours are 8-bit levels,
    written slightly above them, as some readers truncate instead of rounding.

    Raises MeshError for a mesh without faces, and for arrays that don't fit together.
    """
    check_mesh(mesh, colors=colors)
    vertices, faces = mesh.vertices, mesh.faces
    levels = np.ceil(np.rint(np.clip(colors, 0, 1) * 255) / 255 * 1e5) / 1e5
    place = "%.15g" if float_is_too_coarse(*box(vertices)) else "%.12g"
    corners = faces[:, :, None].repeat(2, axis=2).reshape(len(faces), 6) + 1
    with path.open("w", encoding="ascii", newline="\n") as file:
        file.write("# written by MGSR; vertex colours are sRGB\n")
        np.savetxt(file, np.hstack([vertices, levels]), f"v {place} {place} {place} %.5f %.5f %.5f")
        np.savetxt(file, mesh.normals, "vn %.6f %.6f %.6f")
        np.savetxt(file, corners, "f %d//%d %d//%d %d//%d")
