"""A wrong surface and wrong images made from a measurement scene's truth, always the same way.

Shared by the tests and the script that asks the reference program for its figures.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import trimesh
from PIL import Image
from scipy.ndimage import gaussian_filter

SCENE = "bunny_flash"  # it has views without specular light


def altered_mesh(scene: Path) -> trimesh.Trimesh:
    """Return the true mesh with waves on it, a piece cut off, a far patch added, and some faces turned round."""
    mesh = trimesh.load_mesh(scene / "mesh_gt.ply", process=False)
    vertices, faces = np.array(mesh.vertices), np.array(mesh.faces)
    vertices += 0.01 * np.sin(20 * vertices[:, [1, 2, 0]])
    middles = vertices[faces].mean(1)
    faces = faces[middles[:, 2] < 0.6]
    turned = middles[middles[:, 2] < 0.6][:, 0] > 0.5
    faces[turned] = faces[turned][:, ::-1]
    patch = np.array([[1.3, 0, 0], [1.5, 0, 0], [1.3, 0.2, 0]])
    faces = np.concatenate([faces, [[len(vertices) + corner for corner in range(3)]]])
    return trimesh.Trimesh(np.concatenate([vertices, patch]), faces, process=False)


def frames(scene: Path) -> list[Path]:
    """Return the paths of the test photographs."""
    listed = json.loads((scene / "transforms_test.json").read_text())["frames"]
    return [scene / f"{frame['file_path']}.png" for frame in listed]


def altered_image(image: np.ndarray, sigma: float) -> np.ndarray:
    """Blur and darken an RGBA photograph, uint8."""
    blurred: np.ndarray = np.rint(0.9 * gaussian_filter(image.astype(np.float64), (sigma, sigma, 0))).astype(np.uint8)
    return blurred


def load(path: Path) -> np.ndarray:
    return np.asarray(Image.open(path))
