"""Small captures on disk, drawn with Pillow: a ball of radius 0.8 at a given place, seen from all around."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

SIDE = 64


def look_at(eye: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Return cam_from_world [4,4], OpenCV axes, z up in the world."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, -rotation @ eye
    return pose


@dataclass
class BallCapture:
    """Cameras on a spiral of radius 3 * scale around `center`; K is off-centre and its pixels aren't square."""

    views: int = 12
    center: np.ndarray = field(default_factory=lambda: np.zeros(3))
    scale: float = 1.0
    radius: float = 0.8
    K: np.ndarray = field(default_factory=lambda: np.array([[80.0, 0, 30], [0, 90, 35], [0, 0, 1]]))

    def poses(self) -> list[np.ndarray]:
        turn = np.arange(self.views) * 2.4
        height = np.linspace(-0.8, 0.8, self.views)
        flat = np.sqrt(1 - height**2)
        eyes = np.stack([flat * np.cos(turn), flat * np.sin(turn), height], axis=1) * 3 * self.scale + self.center
        return [look_at(eye, self.center) for eye in eyes]

    def mask(self, pose: np.ndarray) -> np.ndarray:
        """Return where the rays of the pixels' centres meet the ball, [SIDE,SIDE] bool."""
        y, x = np.mgrid[:SIDE, :SIDE] + 0.5
        rays = np.stack([(x - self.K[0, 2]) / self.K[0, 0], (y - self.K[1, 2]) / self.K[1, 1], np.ones_like(x)], -1)
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        ball = pose[:3, :3] @ self.center + pose[:3, 3]
        along = rays @ ball
        inside: np.ndarray = ball @ ball - along**2 < (self.radius * self.scale) ** 2
        return inside

    def rgba(self, pose: np.ndarray) -> np.ndarray:
        mask = self.mask(pose)
        colors = np.where(mask[..., None], [200, 100, 50], [7, 7, 7])
        return np.concatenate([colors, mask[..., None] * 255], axis=-1).astype(np.uint8)

    def write_plain(self, root: Path, mode: str = "RGBA") -> Path:
        views = []
        for i, pose in enumerate(self.poses()):
            name = f"photos/{i:03d}.png"
            save(root / name, self.rgba(pose), mode)
            views.append({"image": name, "K": self.K.tolist(), "cam_from_world": pose.tolist()})
        (root / "cameras.json").write_text(json.dumps({"views": views}))
        return root

    def write_masks(self, root: Path) -> None:
        for i, pose in enumerate(self.poses()):
            save(root / f"masks/{i:03d}.png", self.rgba(pose)[..., 3], "L")

    def write_blender(self, root: Path, test: int = 0) -> Path:
        frames: dict[str, list[dict[str, Any]]] = {"train": [], "test": []}
        for i, pose in enumerate(self.poses()):
            part = "test" if i < test else "train"
            number = len(frames[part])
            save(root / part / f"r_{number}.png", self.rgba(pose), "RGBA")
            opengl = np.linalg.inv(pose) @ np.diag([1.0, -1, -1, 1])
            frames[part].append({"file_path": f"./{part}/r_{number}", "transform_matrix": opengl.tolist()})
        lens = {"fl_x": 80.0, "fl_y": 90.0, "cx": 30.0, "cy": 35.0, "w": SIDE, "h": SIDE}
        for part, rows in frames.items():
            if rows:
                (root / f"transforms_{part}.json").write_text(json.dumps({**lens, "frames": rows}))
        return root


def save(path: Path, pixels: np.ndarray, mode: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(pixels).convert(mode).save(path)


def edit_json(path: Path, change: Callable[[Any], object]) -> None:
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))
