"""Results of a job that never ran, written by the library's own exporters: a coloured box, splats on it, one view."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import trimesh

from mgsr.export.gltf import PbrMaterial, UpAxis
from mgsr.export.mesh_files import png_bytes, write_ply, write_textured_glb
from mgsr.export.radiance_map import write_radiance_map
from mgsr.export.renders import Rendering, write_view
from mgsr.export.splats import write_splats
from tests.export.test_mesh_files import mesh_and_colors

METRICS = {
    "psnr_test": 31.42,
    "ssim_test": 0.951,
    "mesh": {"vertices": 24, "faces": 12},
    "gaussians": {"gaussians": 400},
    "seconds": {"total": 75.0},
}
# Off the origin: the viewer must bring mesh and splats together there.
MIDDLE = np.array([5.0, -3.0, 2.0])
# As far as maps have it, with splats about an origin beside the middle.
FAR_MIDDLE, FAR_ORIGIN = np.array([512345.25, 4501234.5, 431.25]), np.array([512344.0, 4501236.0, 433.0])
LAMP, LAMP_EDGE = 4.0, 0.9  # the radiance of the lamp in environment.exr, and the cosine from its middle to its edge
RED, SIZE = (0.85, 0.1, 0.1), 48
TRANSMITTED, REFLECTED, WEIGHT, EVEN = 0.5, 0.4, 0.5, 0.8
REPORT = (
    "<!doctype html><style>p{color:green}</style><p id=text>before</p>"
    "<script>document.getElementById('text').textContent='made-up report'</script>"
)


def make_results(folder: Path, middle: np.ndarray = MIDDLE, origin: np.ndarray | None = None) -> dict[str, bytes]:
    """Return every result file by its name; the splats are about an origin [3] that their file names, if given."""
    box = trimesh.creation.box((2.0, 1.0, 1.0))
    box.unmerge_vertices()  # so that each side has normals of its own
    arrays = (box.vertices + middle, box.faces, box.vertex_normals, np.tile(RED, (len(box.vertices), 1)))
    write_ply(folder / "mesh.ply", *mesh_and_colors(*arrays))
    red = png_bytes(np.full((4, 4, 3), np.rint(np.array(RED) * 255), np.uint8))
    flat, white = png_bytes(np.full((4, 4, 3), (128, 128, 255), np.uint8)), png_bytes(np.full((4, 4), 255, np.uint8))
    uvs = np.full((len(box.vertices), 2), 0.5)
    tangents = np.concatenate([np.roll(box.vertex_normals, 1, axis=1), np.ones((len(box.vertices), 1))], axis=1)
    material = PbrMaterial(red, flat, white, roughness=1.0, metallic=0.0)
    write_textured_glb(folder / "model.glb", mesh_and_colors(*arrays)[0], uvs, tangents, material, UpAxis.Z)
    write_radiance_map(folder / "environment.exr", _lamp(), UpAxis.Z)
    about = middle if origin is None else middle - origin
    write_splats(folder / "splats_3d.ply", _splats(about), origin=origin)
    write_view(folder / "renders" / "test", "r_0", _view())
    (folder / "report.html").write_text(REPORT)
    (folder / "report.json").write_text(json.dumps(METRICS))
    (folder / "log.txt").write_text("the made-up log")
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def _lamp() -> np.ndarray:
    """Return a map [32,64,3] in the box's frame, z up, with a wide lamp between the directions +x and -y.

    In the frame of model.glb, it lies between +x and +z, so that it lights these two sides of the box alike.
    """
    polar, azimuth = np.meshgrid((np.arange(32) + 0.5) / 32 * np.pi, (np.arange(64) + 0.5) / 32 * np.pi, indexing="ij")
    towards = np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], axis=-1)
    lit = towards @ (np.array([1.0, -1, 0]) / np.sqrt(2)) > LAMP_EDGE
    return np.where(lit[..., None], np.float32(LAMP), np.float32(0)) * np.ones(3, np.float32)


def _splats(middle: np.ndarray) -> dict[str, np.ndarray]:
    """Return opaque red blobs inside the box around a place [3]."""
    random = np.random.default_rng(0)
    count = 400
    sh = np.zeros((count, 4, 3))
    sh[:, 0] = (np.array(RED) - 0.5) / 0.28209479177387814  # the constant basis function
    return {
        "means": middle + random.uniform(-1, 1, (count, 3)) * (0.9, 0.4, 0.4),
        "quats": np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)),
        "log_scales": np.full((count, 3), np.log(0.08)),
        "opacity_logits": np.full(count, 6.0),
        "sh": sh,
    }


def _view() -> Rendering:
    """Return a grey square with a reflection on its right half, brighter under even light."""
    flat = np.ones((SIZE, SIZE, 3))
    right = np.zeros((SIZE, SIZE))
    right[:, SIZE // 2 :] = WEIGHT
    reflected = flat * REFLECTED
    return Rendering(
        color=flat * TRANSMITTED + right[..., None] * reflected,
        alpha=np.ones((SIZE, SIZE)),
        depth=np.ones((SIZE, SIZE)),
        normal=flat,
        transmitted=flat * TRANSMITTED,
        reflected=reflected,
        weight=right,
        unlit=flat * EVEN,
    )
