"""The walk whose frames make a video: a smooth path, on which the renderer puts its cameras."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from benchmarks.render_scenes import RenderError
from benchmarks.render_walk import COUNTED, DISTANCE, TOOL, tool_for, walk


def test_the_walk_is_three_turns_without_jumps() -> None:
    places = walk(300)[:, :3]
    azimuth = np.unwrap(np.arctan2(places[:, 1], places[:, 0]))
    assert azimuth[-1] - azimuth[0] == pytest.approx(6 * np.pi)
    elevation = np.degrees(np.arcsin(places[:, 2] / np.linalg.norm(places, axis=1)))
    assert elevation.min() > 10 and elevation.max() > 55
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    assert steps.min() > 0.01 * DISTANCE and steps.max() < 0.1 * DISTANCE


def test_the_renderer_puts_its_cameras_there(tmp_path: Path, shared_data: Path) -> None:
    rows, middle = walk(40), np.array([0.0, 0.0, 0.7])
    np.save(tmp_path / "cameras.npy", rows)
    source = (shared_data.parent / "tools" / TOOL).read_text(encoding="utf-8")
    ours = tool_for(tmp_path / "cameras.npy", source)
    section = "".join(ours.partition("def look(")[1:]).partition(COUNTED)[0]
    given = SimpleNamespace(views=10, dist=DISTANCE)
    names: dict[str, Any] = {"np": np, "math": math, "a": given, "center": middle, "rng": np.random.default_rng(0)}
    exec(section, names)
    poses = np.array(names["poses"])
    assert np.allclose(poses[:, :3, 3], middle + rows[:, :3])
    forward = (rows[:, 3:6] - rows[:, :3]) / np.linalg.norm(rows[:, 3:6] - rows[:, :3], axis=1, keepdims=True)
    assert np.allclose(-poses[:, :3, 2], forward)


@pytest.mark.parametrize("count", [0, 2])
def test_another_renderer_is_refused(count: int) -> None:
    with pytest.raises(RenderError, match=f"got it {count} times"):
        tool_for(Path("cameras.npy"), COUNTED * count)
