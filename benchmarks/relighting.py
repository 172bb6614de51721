"""Relighting of model.glb, held against path-traced truth under light that no photograph had.

    python -m benchmarks.relighting SCENE OUT [--size 96] [--samples 32]

SCENE: a rendered scene with mesh_gt.ply and scene_info.json. OUT: the results of a run on it. The model and the true
surface with its true material are path-traced by Mitsuba (variant scalar_rgb) from the first test views, under two
environments. The same model with the photographs' mean colours as a matte base colour is the comparison. Prints the
PSNR on the object after one gain for each image, and roughness and metallic beside the true ones. Materials of the
truth: a conductor, a clear coat, or a matte colour. The normal map is left out: it is flat where the model has all
faces.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import mitsuba
import numpy as np
import trimesh

from mgsr.config import DataConfig, MeshConfig
from mgsr.data.images import linear_to_srgb
from mgsr.data.readers import load_scene
from mgsr.data.scene import Scene, View
from mgsr.geometry.raycast import RayCaster
from mgsr.mesh.baking import bake_colors, find_texels
from mgsr.mesh.surface import ReconstructedMesh
from mgsr.mesh.unwrap import UnwrappedMesh
from mgsr.mesh.views import SurfaceView
from mgsr.pipeline.result_files import read_mesh

VIEWS = 3
UPRIGHT = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # from model.glb's axes, y up, to the scenes', z up


def environment(seed: int, rows: int = 64) -> np.ndarray:
    """Return a sky with soft boxes [rows,2*rows,3], linear, whose places depend on the seed."""
    random = np.random.default_rng(1000 + seed)
    down, around = np.meshgrid(
        (np.arange(rows) + 0.5) / rows * np.pi, (np.arange(2 * rows) + 0.5) / rows * np.pi, indexing="ij"
    )
    towards = np.stack([np.sin(down) * np.cos(around), np.cos(down), np.sin(down) * np.sin(around)], axis=-1)
    light = 0.4 + 0.3 * towards[..., 1:2] * np.array([0.8, 0.9, 1.1])
    for _ in range(4):
        box = random.normal(size=3)
        light = np.where((towards @ (box / np.linalg.norm(box)))[..., None] > 0.94, random.uniform(3, 8, 3), light)
    return np.asarray(light, np.float32)


def true_material(info: dict[str, Any]) -> dict[str, Any]:
    """Return the scene's material for Mitsuba, from the arguments that rendered it."""
    color = {"type": "rgb", "value": [float(each) for each in info["color"].split(",")]}
    if info["material"] == "conductor":
        return {"type": "roughconductor", "material": info["metal"], "alpha": info["roughness"], "distribution": "ggx"}
    if info["material"] == "clearcoat":
        coat = {"clearcoat": 1.0, "clearcoat_gloss": 0.97, "specular": 0.5, "roughness": info["roughness"] or 0.5}
        return {"type": "principled", "base_color": color} | coat
    if info["material"] == "diffuse" and info["texture"] is None:
        return {"type": "diffuse", "reflectance": color}
    raise SystemExit(f"{info['material']} with texture {info['texture']}: expected a conductor, a coat or one colour")


def traced(shape: Any, light: np.ndarray, view: View, scene: Scene, size: int, samples: int) -> np.ndarray:
    """Return the picture [size,size,4] of a shape in the user's frame from a view's camera, linear, premultiplied."""
    camera = scene.user_from_scene.camera_to_user(view.camera)
    pose = np.linalg.inv(camera.cam_from_world)
    pose[:3, :2] *= -1  # Mitsuba's cameras have x left and y up
    transform = mitsuba.ScalarTransform4f
    angle = float(np.degrees(2 * np.arctan(camera.width / 2 / camera.K[0, 0])))
    film = {"type": "hdrfilm", "width": size, "height": size, "pixel_format": "rgba", "rfilter": {"type": "box"}}
    sensor = {"type": "perspective", "fov": angle, "to_world": transform(pose), "film": film}
    lamp = {
        "type": "envmap",
        "bitmap": mitsuba.Bitmap(np.ascontiguousarray(light, np.float32)),
        "to_world": transform().rotate([1, 0, 0], 90),
    }
    integrator = {"type": "path", "max_depth": 5, "hide_emitters": True}
    world = mitsuba.load_dict(
        {"type": "scene", "integrator": integrator, "sensor": sensor, "lamp": lamp, "shape": shape}
    )
    return np.asarray(np.nan_to_num(np.asarray(mitsuba.render(world, spp=samples))))


def as_shape(mesh: UnwrappedMesh | ReconstructedMesh | trimesh.Trimesh, material: dict[str, Any]) -> Any:
    """Return Mitsuba's mesh with a two-sided material, with texture coordinates where the mesh has some."""
    properties = mitsuba.Properties()
    properties["bsdf"] = mitsuba.load_dict({"type": "twosided", "material": material})
    uvs = getattr(mesh, "uvs", None)
    sizes = len(mesh.vertices), len(mesh.faces)
    normals = np.asarray(mesh.vertex_normals if isinstance(mesh, trimesh.Trimesh) else mesh.normals, np.float32)
    shape = mitsuba.Mesh(
        "model", *sizes, has_vertex_normals=True, has_vertex_texcoords=uvs is not None, props=properties
    )
    values = mitsuba.traverse(shape)
    values["vertex_positions"] = np.asarray(mesh.vertices, np.float32).ravel()
    values["vertex_normals"] = normals.ravel()
    values["faces"] = np.asarray(mesh.faces, np.uint32).ravel()
    if uvs is not None:
        values["vertex_texcoords"] = np.asarray(uvs * [1, -1] + [0, 1], np.float32).ravel()
    values.update()
    return shape


def read_model(path: Path) -> tuple[UnwrappedMesh, np.ndarray, float, float]:
    """Return the mesh of model.glb in the scene's axes, its base colour [H,W,3] sRGB, roughness and metallic."""
    loaded: Any = trimesh.load_scene(path, process=False).to_mesh()
    surface = loaded.visual.material
    picture = np.asarray(surface.baseColorTexture.convert("RGB"))
    vertices, normals = (np.asarray(each) @ UPRIGHT.T for each in (loaded.vertices, loaded.vertex_normals))
    uvs = np.asarray(loaded.visual.uv) * [1, -1] + [0, 1]
    mesh = UnwrappedMesh(vertices, np.asarray(loaded.faces), uvs, np.zeros((len(uvs), 4)), picture.shape[:2])
    return mesh.with_normals(normals.astype(np.float32)), picture, surface.roughnessFactor, surface.metallicFactor


def photograph_colors(mesh: UnwrappedMesh, full: ReconstructedMesh, scene: Scene) -> np.ndarray:
    """Return the mean colours of the photographs as a picture [H,W,3] uint8 sRGB, for a mesh in the user's frame."""
    caster: RayCaster = full.caster
    views = []
    for view in scene.train:
        camera = scene.user_from_scene.camera_to_user(view.camera)
        hits = caster.cast(camera)
        views.append(
            SurfaceView(
                camera, hits.depth, hits.normal, hits.mask.astype(np.float32), (view.image / 255).astype(np.float32)
            )
        )
    texels = find_texels(mesh, full)
    colors = bake_colors(texels, full, views, MeshConfig())
    return texels.picture(np.rint(colors * 255).astype(np.uint8))


def bitmap(picture: np.ndarray) -> dict[str, Any]:
    """Return a texture [H,W,3] uint8 sRGB for Mitsuba."""
    return {"type": "bitmap", "bitmap": mitsuba.Bitmap(np.array(picture, np.uint8, order="C")), "wrap_mode": "clamp"}


def score(image: np.ndarray, truth: np.ndarray) -> float:
    """Return the PSNR of sRGB values on the object, after the gain of linear light that fits best."""
    inside = (image[..., 3] > 0.99) & (truth[..., 3] > 0.99)
    ours, true = image[inside][:, :3], truth[inside][:, :3]
    gain = (ours * true).sum() / (ours * ours).sum()
    error = linear_to_srgb(np.clip(gain * ours, 0, 1)) - linear_to_srgb(np.clip(true, 0, 1))
    return float(-10 * np.log10((error**2).mean()))


def main() -> None:
    """Print the scores of one run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--size", type=int, default=96)
    parser.add_argument("--samples", type=int, default=32)
    given = parser.parse_args()
    mitsuba.set_variant("scalar_rgb")
    scene, info = (
        load_scene(given.scene, DataConfig()),
        json.loads((given.scene / "scene_info.json").read_text())["args"],
    )
    mesh, picture, roughness, metallic = read_model(given.out / "model.glb")
    gloss = {"roughness": roughness, "metallic": metallic, "specular": 0.5}
    photographs = photograph_colors(mesh, read_mesh(given.out), scene)
    truth = trimesh.load_mesh(given.scene / "mesh_gt.ply", process=False)
    assert isinstance(truth, trimesh.Trimesh)
    shapes = [
        as_shape(truth, true_material(info)),
        as_shape(mesh, {"type": "principled", "base_color": bitmap(picture)} | gloss),
        as_shape(mesh, {"type": "diffuse", "reflectance": bitmap(photographs)}),
    ]
    scores = []
    for seed in range(2):
        for view in scene.test[:VIEWS]:
            images = [traced(shape, environment(seed), view, scene, given.size, given.samples) for shape in shapes]
            scores.append([score(image, images[0]) for image in images[1:]])
    ours, matte = np.mean(scores, axis=0)
    print(f"{given.scene.name}: model {ours:.2f} dB, photograph colours {matte:.2f} dB")
    print(f"roughness {roughness:.2f}, metallic {metallic:.0f}; true: {info['material']}, width {info['roughness']}")


if __name__ == "__main__":
    main()
