"""The file that says where the object of a capture lies: written by a run, or by a user."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mgsr.data.photo_files import SceneFolder
from mgsr.errors import SceneError

OBJECT_FILE = "object.json"


@dataclass(frozen=True)
class ObjectPlace:
    """Where an object lies, in the user's frame.

    box [2,3]: the least and the largest corner. ground [4]: the plane on which it stands, with a unit normal that
    points up (see `Scene.ground`); None if it is unknown.
    """

    box: np.ndarray
    ground: np.ndarray | None = None


def read_object_place(folder: SceneFolder) -> tuple[ObjectPlace | None, tuple[str, ...]]:
    """Read the object's place from object.json in the scene's folder, or in a folder above it up to the top.

    Returns None without such a file. Also returns notes: a file of this name without a box is ignored with a note,
    because other programs use the name too. Raises SceneError for an unreadable file, and for an invalid box or ground.
    """
    around = (each for each in (folder.root, *folder.root.parents) if each.is_relative_to(folder.top))
    path = next((each / OBJECT_FILE for each in around if (each / OBJECT_FILE).is_file()), None)
    if path is None:
        return None, ()
    content = _content(path)
    if "box" not in content:
        return None, (f"{OBJECT_FILE} has no box, so it does not say where the object lies",)
    low, high = _numbers(content["box"], 6, f"{OBJECT_FILE}: box", "x0, y0, z0, x1, y1, z1").reshape(2, 3)
    if not (low < high).all():
        raise SceneError(
            f"{OBJECT_FILE}: box: expected x0 < x1, y0 < y1 and z0 < z1, got {[*low.tolist(), *high.tolist()]}"
        )
    ground = content.get("ground")
    return ObjectPlace(np.stack([low, high]), None if ground is None else _plane(ground)), ()


def _content(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise SceneError(f"{path.name}: expected JSON with the object's box, got an unreadable file: {error}") from None
    return content if isinstance(content, dict) else {}


def _plane(value: Any) -> np.ndarray:
    plane = _numbers(value, 4, f"{OBJECT_FILE}: ground", "a, b, c, d of the plane ax + by + cz + d = 0")
    length = float(np.linalg.norm(plane[:3]))
    if length < 1e-9:
        raise SceneError(f"{OBJECT_FILE}: ground: expected a normal that is not zero, got {plane.tolist()}")
    return np.asarray(plane / length)


def _numbers(value: Any, count: int, name: str, what: str) -> np.ndarray:
    """Return a list of so many finite numbers [count]. Raises SceneError for anything else."""
    right = isinstance(value, list) and len(value) == count and all(type(each) in (int, float) for each in value)
    numbers = np.array(value, np.float64) if right else np.array([np.nan])
    if not np.isfinite(numbers).all():
        raise SceneError(f"{name}: expected {count} numbers {what}, got {str(value)[:80]}")
    return numbers
