"""A capture in the blender layout with a known surface: coloured spheres, ray-cast by numpy."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from PIL import Image

from mgsr.data.camera import Camera

# Centre, radius and colour of each; they overlap, so that they are one body.
SPHERES = (
    (np.array([0.0, 0.0, 0.0]), 0.6, np.array([0.8, 0.3, 0.2])),
    (np.array([0.5, 0.2, 0.3]), 0.35, np.array([0.2, 0.6, 0.3])),
    (np.array([-0.4, 0.3, 0.4]), 0.3, np.array([0.2, 0.3, 0.8])),
)
ANGLE = 1.0  # of view, radians; wide, so that few views already carve all space around the spheres
DISTANCE = 3.0
SAMPLES = 3


def write_spheres(folder: Path, size: int = 64, train: int = 14, test: int = 2) -> Path:
    """Write the capture with its `mesh_gt.ply` to a new folder, and return the folder."""
    directions = _directions(train + test)
    held_out = set(range(3, train + test, (train + test) // test)[:test])
    for split in ("train", "test"):
        chosen = [i for i in range(train + test) if (i in held_out) == (split == "test")]
        frames = [_write_frame(folder, split, number, directions[i], size) for number, i in enumerate(chosen)]
        (folder / f"transforms_{split}.json").write_text(json.dumps({"camera_angle_x": ANGLE, "frames": frames}))
    parts = [trimesh.creation.icosphere(3, radius).apply_translation(center) for center, radius, _ in SPHERES]
    trimesh.util.concatenate(parts).export(folder / "mesh_gt.ply")
    return folder


def held_out_camera(folder: Path, number: int, size: int) -> Camera:
    """Return the camera of a test view, by the capture's own file and in its frame."""
    file = json.loads((folder / "transforms_test.json").read_text())
    focal = size / 2 / np.tan(file["camera_angle_x"] / 2)
    K = np.array([[focal, 0, size / 2], [0, focal, size / 2], [0, 0, 1]])
    world_from_cam = np.array(file["frames"][number]["transform_matrix"]) @ np.diag([1.0, -1.0, -1.0, 1.0])
    return Camera(K, np.linalg.inv(world_from_cam), size, size)


def _directions(count: int) -> np.ndarray:
    i = np.arange(count) + 0.5
    z, turn = 1 - 2 * i / count, i * np.pi * (1 + 5**0.5)
    ring = np.sqrt(1 - z * z)
    return np.stack([ring * np.cos(turn), ring * np.sin(turn), z], axis=1)


def _write_frame(folder: Path, split: str, number: int, direction: np.ndarray, size: int) -> dict[str, Any]:
    pose = _camera_to_world(direction)
    (folder / split).mkdir(parents=True, exist_ok=True)
    Image.fromarray(_photograph(pose, size)).save(folder / split / f"r_{number}.png")
    return {"file_path": f"{split}/r_{number}", "transform_matrix": pose.tolist()}


def _camera_to_world(direction: np.ndarray) -> np.ndarray:
    """Return the camera's pose [4,4] in the world, OpenGL axes: the camera looks along -z, y is up."""
    right = np.cross([0.1, 0.2, 1.0], direction)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(direction, right), direction], axis=1)
    pose[:3, 3] = DISTANCE * direction
    return pose


def _photograph(pose: np.ndarray, size: int) -> np.ndarray:
    """Ray-cast an image [size,size,4] uint8, alpha not premultiplied, with SAMPLES x SAMPLES rays per pixel."""
    fine = size * SAMPLES
    rows, columns = (np.mgrid[:fine, :fine] + 0.5) / fine * 2 - 1
    reach = np.tan(ANGLE / 2)
    rays = np.stack([columns * reach, -rows * reach, -np.ones_like(rows)], axis=-1) @ pose[:3, :3].T
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    color, hit = _shade(pose[:3, 3], rays)
    blocks = (size, SAMPLES, size, SAMPLES)
    alpha = hit.reshape(blocks).mean(axis=(1, 3))
    mean = (color * hit[..., None]).reshape(*blocks, 3).mean(axis=(1, 3)) / np.maximum(alpha, 1e-6)[..., None]
    return (np.dstack([mean, alpha]).clip(0, 1) * 255).round().astype(np.uint8)


def _shade(eye: np.ndarray, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the nearest sphere's colour, lit from above, and whether the ray hits one."""
    nearest, color = np.full(rays.shape[:2], np.inf), np.zeros(rays.shape)
    for center, radius, tint in SPHERES:
        along = rays @ (center - eye)
        inside = radius**2 - ((center - eye) @ (center - eye) - along**2)
        depth = np.where(inside > 0, along - np.sqrt(np.maximum(inside, 0)), np.inf)
        closer = depth < nearest
        points = eye + rays[closer] * depth[closer][:, None]
        normals = (points - center) / radius
        stripes = 0.8 + 0.2 * np.sin(12 * points.sum(1, keepdims=True))
        color[closer] = tint * stripes * (0.75 + 0.25 * normals[:, 2:])
        nearest = np.minimum(nearest, depth)
    return color, np.isfinite(nearest)
