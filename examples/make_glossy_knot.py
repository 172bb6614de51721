"""Make the example capture `examples/glossy_knot`: photographs of a glossy knot under a flash, with ground truth.

    python examples/make_glossy_knot.py [--out FOLDER]

Needs Mitsuba 3 (`pip install mitsuba`), which the package itself does not. The fast variant of Mitsuba wants a libLLVM
of the system; name it in DRJIT_LIBLLVM_PATH where it is not found, or the slower scalar variant renders instead.
"""

from __future__ import annotations

import argparse
import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import open3d as o3d
import trimesh
from knot_shape import Array, KnotShape, Surface, normalised
from numpy.typing import NDArray
from PIL import Image

SIZE = 256
FOV = 0.69
FOCAL = 0.5 * SIZE / math.tan(FOV / 2)
DISTANCE = 3.2
TRAIN_VIEWS = 40
TEST_VIEWS = 6
SEED = 7

# Marching cubes cell in the shape's units, and the faces of the mesh that is handed out as the truth.
CELL = 0.0135
TRUTH_FACES = 29_000
TRUTH_POINTS = 100_000

# Rays a pixel in each of the renders that make a photograph.
SAMPLES = 36
RENDERS = 5
# Bounces of light, the first hit included.
MAX_DEPTH = 4
# GGX width of the lacquer, and its specular strength (principled model: 1 reflects 8% at normal incidence).
ROUGHNESS = 0.1
SPECULAR = 1.0
# The flash stands this far from the lens, right, up and back in the camera's frame: near, but not at one point with it.
FLASH_OFFSET = (0.12, 0.18, 0.0)
FLASH_INTENSITY = 30.0
AMBIENT = 0.08

# Coordinates are rounded to 2^-14 of the object's radius: far below what the metrics see, and it halves the files.
GRID = 2.0**14


@dataclass(frozen=True)
class Geometry:
    """What one camera sees, image-shaped: z-depth, world normals as shaded and of the facets, mask of the hits."""

    depth: NDArray[np.float32]
    normal: Array
    normal_geo: Array
    mask: NDArray[np.bool_]


class Studio:
    """The object, flash and camera as a Mitsuba scene; the gloss can be left out."""

    def __init__(self, surface: Surface, glossy: bool) -> None:
        self._scene = mi.load_dict(
            {
                "type": "scene",
                "integrator": {"type": "path", "max_depth": MAX_DEPTH, "hide_emitters": True},
                "sensor": _sensor(),
                "flash": {
                    "type": "point",
                    "position": [0, 0, 0],
                    "intensity": {"type": "rgb", "value": FLASH_INTENSITY},
                    # The flash gives most of the light and so gets most of the samples.
                    "sampling_weight": 4.0,
                },
                "ambient": {"type": "constant", "radiance": {"type": "rgb", "value": AMBIENT}},
                "object": _mitsuba_mesh(surface, glossy),
            }
        )
        self._parameters = mi.traverse(self._scene)

    def photograph(self, world_from_cam: Array, seed: int) -> NDArray[np.uint8]:
        """Straight-alpha sRGB image [H,W,4] from an OpenGL camera pose [4,4]; light above 1 is clipped."""
        mitsuba_axes = world_from_cam @ np.diag([-1.0, 1, -1, 1])
        self._parameters["sensor.to_world"] = mi.ScalarTransform4f(mitsuba_axes.tolist())
        flash = world_from_cam[:3, :3] @ FLASH_OFFSET + world_from_cam[:3, 3]
        self._parameters["flash.position"] = flash.tolist()
        self._parameters.update()
        image = self._render(seed)
        alpha = np.clip(image[..., 3:], 0, 1)
        color = srgb_from_linear(image[..., :3] / np.maximum(alpha, 1e-6)) * (alpha > 0)
        return np.round(np.concatenate([color, alpha], axis=-1) * 255).astype(np.uint8)

    def _render(self, seed: int) -> Array:
        """Linear light premultiplied by alpha, [H,W,4]: the mean of several renders without each pixel's brightest and
        darkest. A ray in thousands finds the flash by way of gloss elsewhere, and would leave a bright speck."""
        seeds = [mi.UInt32(each) for each in range(RENDERS * seed, RENDERS * (seed + 1))]
        renders = [np.array(mi.render(self._scene, spp=SAMPLES, seed=each), dtype=np.float64) for each in seeds]
        image: Array = np.sort(renders, axis=0)[1:-1].mean(axis=0)
        image[..., 3] = np.mean([render[..., 3] for render in renders], axis=0)
        return image


def _sensor() -> dict[str, Any]:
    return {
        "type": "perspective",
        "fov": math.degrees(FOV),
        "near_clip": 0.1,
        "far_clip": 20.0,
        "film": {
            "type": "hdrfilm",
            "width": SIZE,
            "height": SIZE,
            "pixel_format": "rgba",
            "rfilter": {"type": "box"},
        },
        # Stratified, which matters for the choice between the two lights: pure chance would make most of the noise.
        "sampler": {"type": "multijitter", "sample_count": SAMPLES},
    }


def _mitsuba_mesh(surface: Surface, glossy: bool) -> Any:
    """Return the surface as lacquer, or without its gloss.

    Its diffuse light does not depend on the specular part, so that without gloss exactly the diffuse part of the glossy
    picture is left, but for what the gloss lights up elsewhere on the object.
    """
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(
        {
            "type": "principled",
            "base_color": {"type": "mesh_attribute", "name": "vertex_color"},
            "specular": SPECULAR if glossy else 0.0,
            # The model takes a perceptual roughness, the square root of GGX's width.
            "roughness": math.sqrt(ROUGHNESS),
        }
    )
    mesh = mi.Mesh("knot", len(surface.vertices), len(surface.faces), has_vertex_normals=True, props=properties)
    mesh.add_attribute("vertex_color", 3, linear_from_srgb(surface.colors).ravel().tolist())
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = surface.vertices.ravel().astype(np.float32)
    parameters["vertex_normals"] = surface.normals.ravel().astype(np.float32)
    parameters["faces"] = surface.faces.ravel().astype(np.uint32)
    parameters.update()
    return mesh


def srgb_from_linear(linear: Array) -> Array:
    """Return sRGB code values 0..1 of linear light, clipped to 0..1 first."""
    x = np.clip(linear, 0, 1)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 1e-9) ** (1 / 2.4) - 0.055)


def linear_from_srgb(srgb: Array) -> Array:
    """Linear light of sRGB code values 0..1."""
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def cameras(count: int, rng: np.random.Generator) -> list[Array]:
    """OpenGL camera-to-world poses [4,4] over the whole sphere: a jittered Fibonacci spiral, looking at the origin."""
    step = np.arange(count) + 0.5 + rng.uniform(-0.25, 0.25, count)
    z = 1 - 2 * step / count
    azimuth = step * math.pi * (3 - math.sqrt(5)) + rng.uniform(0, 2 * math.pi) + rng.uniform(-0.15, 0.15, count)
    flat = np.sqrt(1 - z**2)
    directions = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), z], axis=1)
    distances = DISTANCE + rng.uniform(-0.08, 0.08, count)
    return [look_at_origin(position) for position in directions * distances[:, None]]


def look_at_origin(position: Array) -> Array:
    """OpenGL camera-to-world pose [4,4] at `position`, the origin in the middle of the image, z up."""
    back = position / np.linalg.norm(position)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3] = np.stack([right, np.cross(back, right), back, position], axis=1)
    return pose


def rays(world_from_cam: Array) -> NDArray[np.float32]:
    """Rays [H,W,6] (origin, direction) through the pixel centres; the direction has length 1 along the view axis."""
    along = (np.arange(SIZE) + 0.5 - SIZE / 2) / FOCAL
    x, y = np.meshgrid(along, -along)
    directions = np.stack([x, y, -np.ones_like(x)], axis=-1) @ world_from_cam[:3, :3].T
    origins = np.broadcast_to(world_from_cam[:3, 3], directions.shape)
    return np.concatenate([origins, directions], axis=-1).astype(np.float32)


class Tracer:
    """Ray casting against a surface."""

    def __init__(self, surface: Surface) -> None:
        self._surface = surface
        self._scene = o3d.t.geometry.RaycastingScene()
        vertices = o3d.core.Tensor.from_numpy(surface.vertices.astype(np.float32))
        self._scene.add_triangles(vertices, o3d.core.Tensor.from_numpy(surface.faces.astype(np.uint32)))

    def geometry(self, world_from_cam: Array) -> Geometry:
        """Draw what the camera sees, at the pixel centres."""
        hits = self._scene.cast_rays(o3d.core.Tensor.from_numpy(rays(world_from_cam)))
        depth = hits["t_hit"].numpy()
        mask = np.isfinite(depth)
        face = self._surface.faces[np.where(mask, hits["primitive_ids"].numpy(), 0)]
        uv = hits["primitive_uvs"].numpy()[..., None]
        corners = self._surface.normals[face]
        normal = (1 - uv.sum(axis=-2)) * corners[..., 0, :] + uv[..., 0, :] * corners[..., 1, :]
        normal = normal + uv[..., 1, :] * corners[..., 2, :]
        seen = mask[..., None]
        facets = hits["primitive_normals"].numpy().astype(np.float64)
        return Geometry(np.where(mask, depth, 0), _unit(normal) * seen, _unit(facets) * seen, mask)

    def seen_by(self, points: Array, normals: Array, poses: list[Array]) -> NDArray[np.uint8]:
        """How many of the cameras see each of the surface points [N,3]."""
        count = np.zeros(len(points), np.uint8)
        for pose in poses:
            towards = pose[:3, 3] - points
            # Starts just off the surface, so that a point does not hide itself, and ends at the camera.
            segment = np.concatenate([points + 1e-3 * normals, towards], axis=1).astype(np.float32)
            hidden = self._scene.test_occlusions(o3d.core.Tensor.from_numpy(segment), tfar=1.0).numpy()
            count += ~hidden & (np.sum(towards * normals, axis=1) > 0)
        return count


def _unit(vectors: Array) -> Array:
    unit: Array = vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)
    return unit


def write_transforms(path: Path, folder: str, poses: list[Array]) -> None:
    """Write the NeRF-synthetic camera file for the images `folder`/r_N.png."""
    frames = [
        {"file_path": f"./{folder}/r_{i}", "transform_matrix": np.round(pose, 9).tolist()}
        for i, pose in enumerate(poses)
    ]
    intrinsics = {"camera_angle_x": FOV, "w": SIZE, "h": SIZE, "fl_x": FOCAL, "fl_y": FOCAL}
    centre = {"cx": SIZE / 2, "cy": SIZE / 2}
    path.write_text(json.dumps({**intrinsics, **centre, "frames": frames}, indent=1) + "\n")


def write_images(studio: Studio, folder: Path, poses: list[Array], seed: int) -> None:
    """One photograph per pose, `folder`/r_N.png."""
    folder.mkdir(parents=True, exist_ok=True)
    for i, pose in enumerate(poses):
        Image.fromarray(studio.photograph(pose, seed + i)).save(folder / f"r_{i}.png", optimize=True)
        print(f"{folder.name}: {i + 1} of {len(poses)}", end="\r", flush=True)
    print()


def write_mesh(path: Path, surface: Surface) -> None:
    """Write the surface with its vertex colours as binary PLY."""
    colors = np.round(surface.colors * 255).astype(np.uint8)
    trimesh.Trimesh(surface.vertices, surface.faces, vertex_colors=colors, process=False).export(path)


def write_points(path: Path, surface: Surface, poses: list[Array]) -> None:
    """Area-uniform points of the surface, their facets' normals and how many training views see each."""
    mesh = trimesh.Trimesh(surface.vertices, surface.faces, process=False)
    points, face = trimesh.sample.sample_surface(mesh, TRUTH_POINTS, seed=SEED)
    points, normals = np.asarray(points), np.asarray(mesh.face_normals)[face]
    n_views = Tracer(surface).seen_by(points, normals, poses)
    rounded = (np.round(points * GRID) / GRID).astype(np.float32)
    np.savez_compressed(path, points=rounded, normals=normals.astype(np.float16), n_views=n_views)
    print(f"points seen by two training views or more: {np.mean(n_views >= 2):.4f}")


def write_geometry(folder: Path, surface: Surface, poses: list[Array]) -> None:
    """Write true depth, normals and mask of each pose, `folder`/r_N.npz."""
    folder.mkdir(parents=True, exist_ok=True)
    tracer = Tracer(surface)
    for i, pose in enumerate(poses):
        geometry = tracer.geometry(pose)
        np.savez_compressed(
            folder / f"r_{i}.npz",
            depth=(np.round(geometry.depth * GRID) / GRID).astype(np.float32),
            normal=geometry.normal.astype(np.float16),
            normal_geo=geometry.normal_geo.astype(np.float16),
            mask=geometry.mask,
        )


def check_masks(folder: Path, surface: Surface, poses: list[Array]) -> None:
    """Stop if the photographs' alpha and the true mesh's projection disagree: some pose or unit would be wrong."""
    tracer = Tracer(surface)
    overlaps = []
    for i, pose in enumerate(poses):
        alpha = np.asarray(Image.open(folder / f"r_{i}.png"))[..., 3] >= 128
        mask = tracer.geometry(pose).mask
        overlaps.append(float((alpha & mask).sum() / (alpha | mask).sum()))
    print(f"alpha against the projected mesh: least IoU {min(overlaps):.4f}")
    if min(overlaps) < 0.99:
        raise RuntimeError(f"{folder}: IoU of alpha and mesh_gt.ply {min(overlaps):.4f}, expected above 0.99")


def choose_variant() -> None:
    """Mitsuba's compiled variant where LLVM is found, its plain one elsewhere."""
    try:
        mi.set_variant("llvm_ad_rgb")
        mi.Float(1.0) + mi.Float(2.0)
    except (ImportError, RuntimeError):
        mi.set_variant("scalar_rgb")
    print(f"Mitsuba {mi.__version__}, {mi.variant()}")


def make(out: Path) -> None:
    """Render and write the whole capture into `out`."""
    shape = KnotShape()
    dense = shape.mesh(CELL)
    fine, truth = normalised(dense, dense), normalised(shape.simplified(dense, TRUTH_FACES), dense)
    rng = np.random.default_rng(SEED)
    train, test = cameras(TRAIN_VIEWS, rng), cameras(TEST_VIEWS, rng)
    out.mkdir(parents=True, exist_ok=True)
    write_transforms(out / "transforms_train.json", "train", train)
    write_transforms(out / "transforms_test.json", "test", test)
    write_mesh(out / "mesh_gt.ply", truth)
    write_points(out / "points_gt.npz", fine, train)
    write_geometry(out / "geom", fine, test)
    glossy = Studio(fine, glossy=True)
    write_images(glossy, out / "test", test, seed=1000)
    check_masks(out / "test", truth, test)
    write_images(Studio(fine, glossy=False), out / "test_matte", test, seed=2000)
    write_images(glossy, out / "train", train, seed=0)
    check_masks(out / "train", truth, train)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "glossy_knot", help="the folder to write")
    arguments = parser.parse_args()
    choose_variant()
    make(arguments.out)


if __name__ == "__main__":
    main()
