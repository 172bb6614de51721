"""A textured ball through an ideal fisheye (angle to place, without any polynomial), every ray followed exactly."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from tests.data.captures import look_at

SIDE = 64
FOCAL = 46.0  # pixels a radian: the sides look 40 degrees aside, and the corners 56
RADIUS, DISTANCE = 0.8, 2.4  # the ball fills 19 degrees to each side of its middle
SAMPLES = 3  # rays along each side of a pixel


def write_fisheye(root: Path, views: int = 16, masked: bool = True) -> Path:
    """Write the capture as nerfstudio has it.

    A third of the cameras look so far beside the ball that their images cut it.
    """
    (root / "images").mkdir(parents=True)
    frames = [_write_frame(root, i, pose, masked) for i, pose in enumerate(poses(views))]
    lens = {"camera_model": "OPENCV_FISHEYE", "fl_x": FOCAL, "fl_y": FOCAL, "cx": SIDE / 2, "cy": SIDE / 2}
    document = lens | {"w": SIDE, "h": SIDE, "frames": frames}
    (root / "transforms.json").write_text(json.dumps(document))
    return root


def poses(views: int) -> list[np.ndarray]:
    """Return the cameras' cam_from_world."""
    i = np.arange(views) + 0.5
    z, turn = 1 - 2 * i / views, i * np.pi * (1 + 5**0.5)
    ring = np.sqrt(1 - z * z)
    eyes = DISTANCE * np.stack([ring * np.cos(turn), ring * np.sin(turn), z], axis=1)
    across = np.cross(eyes, np.stack([np.sin(3 * i), np.cos(3 * i), 0 * i], axis=1))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    return [look_at(eye, (0.1, 0.1, 1.6)[k % 3] * across[k]) for k, eye in enumerate(eyes)]


def rays(places: np.ndarray) -> np.ndarray:
    """Return unit directions [...,3] in the camera's frame of places [...,2] on the photograph, in pixels."""
    offsets = (places - SIDE / 2) / FOCAL
    angle = np.linalg.norm(offsets, axis=-1, keepdims=True)
    return np.concatenate([np.sinc(angle / np.pi) * offsets, np.cos(angle)], axis=-1)


def ball_color(points: np.ndarray) -> np.ndarray:
    """Return the ball's colour, 0..1, at points [...,3]."""
    colors: np.ndarray = 0.5 + 0.4 * np.sin(points * [9.0, 7.0, 5.0] + [0.0, 1.0, 2.0])
    return colors


def photograph(pose: np.ndarray) -> np.ndarray:
    """Ray-cast a photograph, uint8 [SIDE,SIDE,4], alpha not premultiplied."""
    rows, columns = (np.mgrid[: SIDE * SAMPLES, : SIDE * SAMPLES] + 0.5) / SAMPLES
    directions = rays(np.stack([columns, rows], axis=-1)) @ pose[:3, :3]
    eye = -pose[:3, :3].T @ pose[:3, 3]
    along = -(directions @ eye)
    inside = RADIUS**2 - (eye @ eye - along**2)
    hit = (inside > 0) & (along > 0)
    points = eye + directions * (along - np.sqrt(np.maximum(inside, 0)))[..., None]
    blocks = (SIDE, SAMPLES, SIDE, SAMPLES)
    alpha = hit.reshape(blocks).mean(axis=(1, 3))
    color = (ball_color(points) * hit[..., None]).reshape(*blocks, 3).mean(axis=(1, 3))
    straight = color / np.maximum(alpha, 1e-6)[..., None]
    return (np.dstack([straight, alpha]).clip(0, 1) * 255).round().astype(np.uint8)


def _write_frame(root: Path, number: int, pose: np.ndarray, masked: bool) -> dict[str, Any]:
    name, pixels = f"images/{number:03d}.png", photograph(pose)
    if not masked:
        alpha = pixels[..., 3:] / 255
        pixels = (pixels[..., :3] * alpha + 255 * (1 - alpha)).round().astype(np.uint8)
    Image.fromarray(pixels).save(root / name)
    opengl = np.linalg.inv(pose) @ np.diag([1.0, -1, -1, 1])
    return {"file_path": name, "transform_matrix": opengl.tolist()}
