"""Checkpoints: one file that holds a run. It is written atomically, and only the same run can read it."""

from __future__ import annotations

import hashlib
import os
import pickle
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from mgsr.config import Config, WatchConfig
from mgsr.config.expert import MeshOptions
from mgsr.data.scene import Scene, View
from mgsr.errors import CheckpointError, in_short

FORMAT = 8


def fingerprint(scene: Scene, config: Config) -> dict[str, str]:
    """Return the hashes by which a checkpoint must match a run.

    They cover the training images and cameras, and the settings that change the result of training.
    """
    digest = hashlib.sha256()
    for view in scene.train:
        digest.update(_view_bytes(view))
    train, expert = replace(config.train, watch=WatchConfig()), replace(config.expert, mesh=MeshOptions())
    settings = repr((config.method, config.seed, config.data, train, expert, config.time_budget is None))
    return {"scene": digest.hexdigest(), "settings": hashlib.sha256(settings.encode()).hexdigest()}


def save_checkpoint(path: Path, content: dict[str, Any]) -> None:
    """Write `content` (plain values and tensors) so that a crash leaves the old file or the new one, never half."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(path.name + ".partial")
    with partial.open("wb") as file:
        torch.save({"format": FORMAT, **content}, file)
        file.flush()
        os.fsync(file.fileno())
    os.replace(partial, path)


def load_checkpoint(path: Path, expected: dict[str, str]) -> dict[str, Any]:
    """Return the content of a checkpoint.

    expected: the run's hashes (see `fingerprint`). Raises CheckpointError when the file can't be read, or belongs to
    another scene or other settings.
    """
    try:
        content = torch.load(path, weights_only=True, map_location="cpu")
    except (OSError, EOFError, RuntimeError, ValueError, KeyError, pickle.UnpicklingError) as error:
        raise CheckpointError(
            f"{path}: this file is not a readable checkpoint ({in_short(error)}); start without resuming"
        ) from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise CheckpointError(f"{path}: this file is not a checkpoint of this version; start without resuming")
    for part, cure in (
        ("scene", "resume with the same images"),
        ("settings", "resume with the same method, seed and settings"),
    ):
        if content["fingerprint"][part] != expected[part]:
            raise CheckpointError(
                f"{path}: the checkpoint belongs to another run, because its {part} differ; {cure}, or start without "
                "resuming"
            )
    return content


def read_schedule(path: Path) -> dict[str, Any] | None:
    """Return the state of a run's stage scheduler from its checkpoint; None if there is no readable one."""
    try:
        content = torch.load(path, weights_only=True, map_location="cpu")
    except (OSError, EOFError, RuntimeError, ValueError, KeyError, pickle.UnpicklingError):
        return None  # resuming from it reports the error
    schedule = content.get("scheduler") if isinstance(content, dict) else None
    return schedule if isinstance(schedule, dict) else None


def _view_bytes(view: View) -> bytes:
    sums = [zlib.crc32(image.tobytes()) for image in (view.image, view.alpha, view.valid_mask) if image is not None]
    pose = np.concatenate([view.camera.K.ravel(), view.camera.cam_from_world.ravel()]).astype(np.float64)
    return f"{view.name} {view.image.shape} {sums}".encode() + pose.tobytes()
