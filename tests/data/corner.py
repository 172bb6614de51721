"""Pictures of a room's corner that are drawn by OpenCV's homographies, with known cameras."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from tests.data.captures import look_at

WIDTH, HEIGHT = 320, 240
K = np.array([[300.0, 0, WIDTH / 2], [0, 300, HEIGHT / 2], [0, 0, 1]])
TEXTURE = 512
# The corner's sides: the origin and the edges of each square, 4 units long.
SIDES = [
    ([-2, -2, -1], [4, 0, 0], [0, 4, 0]),
    ([-2, 2, -1], [4, 0, 0], [0, 0, 4]),
    ([-2, -2, -1], [0, 4, 0], [0, 0, 4]),
]


def poses(count: int = 8) -> list[np.ndarray]:
    """Return cameras on an arc before the corner, cam_from_world [4,4]."""
    turns = np.linspace(0.15, 1.35, count)
    eyes = [[5 * np.sin(turn), -5 * np.cos(turn), 2 + 0.3 * np.sin(5 * turn)] for turn in turns]
    return [look_at(np.array(eye), np.array([-0.6, 0.6, 0.3])) for eye in eyes]


def picture(pose: np.ndarray) -> np.ndarray:
    """Draw the nearer sides over the farther ones; they meet in edges, so that their order doesn't matter."""
    image = np.full((HEIGHT, WIDTH, 3), 90, np.uint8)
    for seed, (origin, across, down) in enumerate(SIDES):
        noise = np.random.default_rng(seed).integers(0, 256, (64, 64, 3), dtype=np.uint8)
        texture = cv2.resize(noise, (TEXTURE, TEXTURE), interpolation=cv2.INTER_CUBIC)
        plane = np.stack([np.array(across) / TEXTURE, np.array(down) / TEXTURE, np.array(origin)], axis=1)
        homography = K @ (pose[:3, :3] @ plane + np.outer(pose[:3, 3], [0, 0, 1]))
        drawn = cv2.warpPerspective(texture, homography, (WIDTH, HEIGHT), flags=cv2.INTER_AREA)
        seen = cv2.warpPerspective(np.full((TEXTURE, TEXTURE), 255, np.uint8), homography, (WIDTH, HEIGHT)) > 127
        image[seen] = drawn[seen]
    return image


def aligned(found: np.ndarray, true: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the rotation and scale that take centred points to others (Kabsch)."""
    found, true = found - found.mean(0), true - true.mean(0)
    left, _, right = np.linalg.svd(true.T @ found)
    rotation = left @ np.diag([1, 1, np.linalg.det(left @ right)]) @ right
    return rotation, float(np.sqrt((true**2).sum() / (found**2).sum()))


def save_pictures(folder: Path, suffix: str = ".png") -> None:
    """Write the pictures of all cameras, named by their numbers."""
    folder.mkdir(parents=True, exist_ok=True)
    for number, pose in enumerate(poses()):
        cv2.imwrite(str(folder / f"{number}{suffix}"), picture(pose))


def camera_errors(found: np.ndarray, true: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the errors of the places and, in degrees, of the directions of cameras [N,4,4], after a similarity."""
    centers = [-np.einsum("nji,nj->ni", item[:, :3, :3], item[:, :3, 3]) for item in (found, true)]
    turn, scale = aligned(*centers)
    rest = scale * (centers[0] - centers[0].mean(0)) @ turn.T - (centers[1] - centers[1].mean(0))
    off = [
        np.degrees(np.arccos(np.clip((np.trace(ours @ turn.T @ theirs.T) - 1) / 2, -1, 1)))
        for ours, theirs in zip(found[:, :3, :3], true[:, :3, :3], strict=True)
    ]
    return np.linalg.norm(rest, axis=1), np.array(off)
