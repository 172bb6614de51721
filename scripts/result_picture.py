"""Make the README's picture from the results of a run.

    python scripts/result_picture.py examples/glossy_knot out/demo r_1 docs/images/result.png

From left to right, one test view: photograph, render, transmitted light, weight x reflected light, the transmitted
light without the flash, normals, mesh.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import trimesh
from PIL import Image

from mgsr.config import DataConfig
from mgsr.data.readers import load_scene
from mgsr.report.shading import MeshPainter, PaintedMesh


def on_white(path: Path) -> np.ndarray:
    """Read an image as [H,W,3] uint8, composited on white if it has alpha."""
    image = Image.open(path).convert("RGBA")
    return np.asarray(Image.alpha_composite(Image.new("RGBA", image.size, "white"), image).convert("RGB"))


def mesh_picture(scene_path: Path, mesh_path: Path, name: str) -> np.ndarray:
    """Render the mesh, shaded as clay, from the test view's camera."""
    scene = load_scene(scene_path, DataConfig())
    view = next(view for view in scene.test if view.name == name)
    mesh = trimesh.load(mesh_path, process=False)
    assert isinstance(mesh, trimesh.Trimesh)
    painter = MeshPainter(PaintedMesh(mesh.vertices, mesh.faces).with_normals(mesh.vertex_normals))
    image = Image.fromarray(painter.shaded(scene.user_from_scene.camera_to_user(view.camera)))
    return np.asarray(Image.alpha_composite(Image.new("RGBA", image.size, "white"), image).convert("RGB"))


def main() -> None:
    scene, out, name, target = Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3], Path(sys.argv[4])
    renders = out / "renders" / "test"
    full, transmitted = on_white(renders / f"{name}.png"), on_white(renders / f"{name}_transmitted.png")
    added = np.clip(full.astype(int) - transmitted, 0, 255).astype(np.uint8)
    row = [on_white(scene / "test" / f"{name}.png"), full, transmitted, added]
    row += [on_white(renders / f"{name}_even.png")]
    row += [on_white(renders / f"{name}_normal.png"), mesh_picture(scene, out / "mesh.ply", name)]
    Image.fromarray(np.concatenate(row, axis=1)).save(target, optimize=True)


if __name__ == "__main__":
    main()
