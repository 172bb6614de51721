"""Relighting of model.glb, held against path-traced truth under light that no photograph had.

    python -m benchmarks.relighting RUNS --scenes FOLDER... [--names NAME...] [-o benchmarks/results/relighting.csv]

RUNS: a folder with the results of a run in RUNS/NAME for each scene; FOLDER/NAME: the rendered scene, with mesh_gt.ply
and scene_info.json. The model and the true surface with its true material are path-traced by Mitsuba from the first
test views, under two environments. The same model with the photographs' mean colours as a matte base colour is the
comparison. Each row has the PSNR on the object after one gain for each image; the same of the base colours against the
true ones; roughness and metallic beside the true ones; and, where the run wrote an environment.exr, the PSNR of the
model in that light against the test photographs, beside that of the splats' renders. A matte model is rendered without
gloss, as its file says. The normal map is left out: it is flat where the model has all faces.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import mitsuba
import numpy as np
import trimesh
from PIL import Image

from benchmarks.evidence.relighting import RelightingRow
from benchmarks.true_materials import VERTEX_COLOR, true_material, true_surface
from mgsr.bench.csv_rows import read_csv, write_csv
from mgsr.bench.machine import program_commit
from mgsr.config import DataConfig, MeshConfig
from mgsr.data.images import linear_to_srgb, srgb_to_linear
from mgsr.data.readers import load_scene
from mgsr.data.scene import Scene, View
from mgsr.geometry.raycast import RayCaster
from mgsr.mesh.baking import bake_colors, find_texels
from mgsr.mesh.surface import ReconstructedMesh
from mgsr.mesh.unwrap import UnwrappedMesh
from mgsr.mesh.views import SurfaceView
from mgsr.pipeline.result_files import read_mesh
from mgsr.pipeline.result_paths import ENVIRONMENT, MODEL_GLB, RENDERS, REPORT

VIEWS = 3
OWN_LIGHT_SAMPLES = 64  # times those in new light: the noise of few is as large as the model's error
UPRIGHT = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # from model.glb's axes, y up, to the scenes', z up
ALBEDO = {"type": "aov", "aovs": "albedo:albedo", "image": {"type": "path", "max_depth": 2, "hide_emitters": True}}
SHADED = {"type": "path", "max_depth": 5, "hide_emitters": True}


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


@dataclass(frozen=True)
class Camera:
    """From where and how Mitsuba looks at a shape. samples: for each pixel."""

    view: View
    scene: Scene
    size: int
    samples: int

    def sensor(self) -> dict[str, Any]:
        """Return Mitsuba's sensor in the user's frame; its picture is square."""
        camera = self.scene.user_from_scene.camera_to_user(self.view.camera)
        pose = np.linalg.inv(camera.cam_from_world)
        pose[:3, :2] *= -1  # Mitsuba's cameras have x left and y up
        angle = float(np.degrees(2 * np.arctan(camera.width / 2 / camera.K[0, 0])))
        film = {"type": "hdrfilm", "width": self.size, "height": self.size, "pixel_format": "rgba"}
        film |= {"rfilter": {"type": "box"}}
        return {"type": "perspective", "fov": angle, "to_world": mitsuba.ScalarTransform4f(pose), "film": film}

    def trace(self, shape: Any, light: np.ndarray) -> np.ndarray:
        """Return the picture [size,size,4] of a shape in a light [H,2H,3], linear, premultiplied."""
        return self._traced(shape, light, SHADED)

    def albedo(self, shape: Any) -> np.ndarray:
        """Return the reflectance of a matte shape [size,size,4], linear, premultiplied."""
        picture = self._traced(shape, np.ones((2, 4, 3)), ALBEDO)
        return np.concatenate([picture[..., 4:], picture[..., 3:4]], axis=-1)

    def photographed(self, image: np.ndarray) -> np.ndarray:
        """Return the picture [size,size,4], linear, premultiplied, of RGBA [H,W,4] uint8 with straight alpha."""
        alpha = image[..., 3:] / 255
        linear = np.concatenate([srgb_to_linear(image[..., :3] / 255) * alpha, alpha], axis=-1).astype(np.float32)
        return np.asarray(cv2.resize(linear, (self.size, self.size), interpolation=cv2.INTER_AREA))

    def _traced(self, shape: Any, light: np.ndarray, integrator: dict[str, Any]) -> np.ndarray:
        turned = mitsuba.ScalarTransform4f().rotate([1, 0, 0], 90)
        bitmap = mitsuba.Bitmap(np.ascontiguousarray(light, np.float32))
        lamp = {"type": "envmap", "bitmap": bitmap, "to_world": turned}
        world = {"type": "scene", "integrator": integrator, "sensor": self.sensor(), "lamp": lamp, "shape": shape}
        rendered = np.asarray(mitsuba.render(mitsuba.load_dict(world), spp=self.samples))
        return np.asarray(np.nan_to_num(rendered))


def as_shape(mesh: UnwrappedMesh | trimesh.Trimesh, material: dict[str, Any], colors: np.ndarray | None = None) -> Any:
    """Return Mitsuba's mesh with a two-sided material, with texture coordinates where the mesh has some.

    colors [V,3]: of the vertices, linear, which the material names VERTEX_COLOR.
    """
    properties = mitsuba.Properties()
    properties["bsdf"] = mitsuba.load_dict({"type": "twosided", "material": material})
    uvs = getattr(mesh, "uvs", None)
    sizes = len(mesh.vertices), len(mesh.faces)
    normals = np.asarray(mesh.vertex_normals if isinstance(mesh, trimesh.Trimesh) else mesh.normals, np.float32)
    shape = mitsuba.Mesh(
        "model", *sizes, has_vertex_normals=True, has_vertex_texcoords=uvs is not None, props=properties
    )
    if colors is not None:
        shape.add_attribute(VERTEX_COLOR, 3, colors.astype(np.float32).ravel())
    values = mitsuba.traverse(shape)
    values["vertex_positions"] = np.asarray(mesh.vertices, np.float32).ravel()
    values["vertex_normals"] = normals.ravel()
    values["faces"] = np.asarray(mesh.faces, np.uint32).ravel()
    if uvs is not None:
        values["vertex_texcoords"] = np.asarray(uvs, np.float32).ravel()
    values.update()
    return shape


def read_model(path: Path) -> tuple[UnwrappedMesh, np.ndarray, float, float]:
    """Return the mesh of model.glb in the scene's axes, its base colour [H,W,3] sRGB, roughness and metallic."""
    scene: Any = trimesh.load_scene(path, process=False)
    # Its `to_mesh` would compute other normals than the file's.
    ((node, name),) = ((each, scene.graph[each][1]) for each in scene.graph.nodes_geometry)
    loaded, placed = scene.geometry[name], scene.graph[node][0]
    surface = loaded.visual.material
    picture = np.asarray(surface.baseColorTexture.convert("RGB"))
    turn = UPRIGHT @ placed[:3, :3]
    vertices = np.asarray(loaded.vertices) @ turn.T + UPRIGHT @ placed[:3, 3]
    normals = np.asarray(loaded.vertex_normals) @ turn.T
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


def matte(color: dict[str, Any]) -> dict[str, Any]:
    """Return Mitsuba's matte material of a colour."""
    return {"type": "diffuse", "reflectance": color}


def relit(path: Path, out: Path, size: int, samples: int) -> RelightingRow:
    """Return the scores of a run in `out` on the scene in `path`.

    Raises ValueError where the scene's true material is not known.
    """
    scene, args = load_scene(path, DataConfig()), json.loads((path / "scene_info.json").read_text())["args"]
    truth = true_material(args)
    loaded = trimesh.load_mesh(path / "mesh_gt.ply", process=False)
    assert isinstance(loaded, trimesh.Trimesh)
    surface, colors = true_surface(loaded, args)
    mesh, picture, roughness, metallic = read_model(out / MODEL_GLB)
    own = {"type": "principled", "base_color": bitmap(picture), "roughness": roughness, "metallic": metallic}
    material = own | {"specular": 0.5}
    if json.loads((out / REPORT).read_text())["material"]["roughness_range"] is None:
        material = matte(bitmap(picture))  # its file has no gloss (KHR_materials_specular)
    seen = bitmap(photograph_colors(mesh, read_mesh(out), scene))
    cameras = [Camera(view, scene, size, samples) for view in scene.test[:VIEWS]]
    shaded = [
        as_shape(surface, truth.bsdf, colors),
        as_shape(mesh, material),
        as_shape(mesh, matte(seen)),
    ]
    plain = [as_shape(surface, matte(truth.base_color), colors)]
    plain += [as_shape(mesh, matte(each)) for each in (bitmap(picture), seen)]
    lit = [[camera.trace(each, environment(seed)) for each in shaded] for seed in range(2) for camera in cameras]
    bare = [[camera.albedo(each) for each in plain] for camera in cameras]
    model, photographs = compare(lit)
    base_color, photograph_color = compare(bare)
    own_light, splats = in_own_light(shaded[1], out, cameras)
    return RelightingRow(
        scene=path.name,
        material=truth.name,
        model=model,
        photographs=photographs,
        base_color=base_color,
        photograph_color=photograph_color,
        roughness=roughness,
        true_roughness=truth.roughness,
        metallic=metallic,
        true_metallic=truth.metallic,
        own_light=own_light,
        splats=splats,
        commit=program_commit(),
    )


def compare(pictures: Sequence[Sequence[np.ndarray]]) -> list[float]:
    """Return the mean score of the second and the third picture of each entry against its first."""
    scores = [[score(each, truth) for each in others] for truth, *others in pictures]
    return [float(each) for each in np.mean(scores, axis=0)]


def in_own_light(shape: Any, out: Path, cameras: Sequence[Camera]) -> tuple[float | None, float | None]:
    """Return the scores of the model in its own environment, and of the splats, against the test photographs.

    None where the run wrote no environment.
    """
    if not (out / ENVIRONMENT).is_file():
        return None, None
    light = np.array(mitsuba.Bitmap(str(out / ENVIRONMENT)).convert(mitsuba.Bitmap.PixelFormat.RGB), np.float32)
    scores = []
    for camera in cameras:
        view = camera.view
        assert view.alpha is not None
        truth = camera.photographed(np.dstack([view.image, view.alpha]))
        splats = np.asarray(Image.open(out / RENDERS / f"{view.name}.png").convert("RGBA"))
        traced = replace(camera, samples=OWN_LIGHT_SAMPLES * camera.samples).trace(shape, light)
        scores.append([score(each, truth) for each in (traced, camera.photographed(splats))])
    ours, theirs = (float(each) for each in np.mean(scores, axis=0))
    return ours, theirs


def main() -> None:
    """Measure the runs, and write their rows in the place of older ones of the same scenes."""
    given = arguments()
    mitsuba.set_variant("scalar_rgb")
    places = {path.name: path for folder in given.scenes for path in folder.iterdir()}
    rows = {row.scene: row for row in read_csv(given.out, RelightingRow)} if given.out else {}
    for name in given.names or sorted(path.name for path in given.runs.iterdir() if (path / MODEL_GLB).is_file()):
        rows[name] = relit(places[name], given.runs / name, given.size, given.samples)
        print(rows[name], flush=True)
        if given.out:
            write_csv(given.out, RelightingRow, [rows[each] for each in sorted(rows)], digits=4)


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", type=Path)
    parser.add_argument("--scenes", type=Path, nargs="+", required=True)
    parser.add_argument("--names", nargs="+")
    parser.add_argument("--size", type=int, default=96)
    parser.add_argument("--samples", type=int, default=32)
    parser.add_argument("-o", dest="out", type=Path)
    return parser.parse_args()


if __name__ == "__main__":
    main()
