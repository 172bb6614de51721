"""Finding the object of a capture without masks, against masks that a ray tracer knows.

tests/pipeline/test_object.py has a quick check of the masks in a whole run.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from mgsr.config.expert import ObjectSearchOptions, SegmentationConfig
from mgsr.data.scene import PHOTOGRAPHS, Scene, View
from mgsr.segmentation.object_masks import FoundObject, NoObject, find_object
from mgsr.start.starting_points import starting_points
from tests.segmentation.table_scene import TABLE, table_scene


def overlaps(found: list[np.ndarray], truth: list[np.ndarray]) -> list[float]:
    """Return the intersection over union of each mask with the true one."""
    pairs = [(mask > 127, true) for mask, true in zip(found, truth, strict=True)]
    return [float((mask & true).sum() / (mask | true).sum()) for mask, true in pairs]


@pytest.fixture(scope="module")
def found() -> tuple[FoundObject, list[np.ndarray]]:
    """Provide the object that is found on the table, and its true masks."""
    scene, truth = table_scene(size=160)
    result = find_object(scene, starting_points(scene, 8000, 0), 0)
    assert isinstance(result, FoundObject), result
    return result, truth


@pytest.mark.slow
def test_masks_are_those_of_the_object(found: tuple[FoundObject, list[np.ndarray]]) -> None:
    result, truth = found
    scores = overlaps(result.train + result.test, truth)
    assert np.mean(scores) > 0.93 and min(scores) > 0.85, scores
    assert result.agreement.shape == (len(result.train),) and result.agreement.min() > 0.8


@pytest.mark.slow
def test_photographs_beyond_the_searched_ones_get_masks_as_good() -> None:
    scene, truth = table_scene(size=160, views=82)
    assert len(scene.train) > PHOTOGRAPHS
    result = find_object(scene, starting_points(scene, 8000, 0), 0)
    assert isinstance(result, FoundObject), result
    scores = overlaps(result.train + result.test, truth)
    assert np.mean(scores) > 0.93 and min(scores) > 0.85, scores
    assert result.agreement.shape == (80,) and result.agreement.min() > 0.8


@pytest.mark.slow
def test_the_table_is_found_and_not_part_of_the_object(found: tuple[FoundObject, list[np.ndarray]]) -> None:
    result, _ = found
    assert result.plane is not None
    assert result.plane.normal @ [0, 0, 1] > 0.999
    assert abs(result.plane.heights(np.array([[0.0, 0.0, TABLE]]))[0]) < 0.02
    low, high = result.box
    assert abs(low[2] - TABLE) < 0.06 and abs(high[2] - 0.65) < 0.06
    assert np.abs(low[:2] + 0.45).max() < 0.08 and np.abs(high[:2] - 0.45).max() < 0.08


@pytest.mark.parametrize(
    ("iterations", "options", "reason"),
    [
        (200, {"copies": 2, "size": 64}, "several objects"),
        pytest.param(400, {"standing": False}, "no level surface|nothing stands|no contour", marks=pytest.mark.slow),
        pytest.param(
            400,
            {"shift": 1.05},
            "cut the object off|nothing stands|do not show the object|no level surface",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_a_capture_without_a_single_object_is_left_whole(iterations: int, options: dict[str, Any], reason: str) -> None:
    scene, _ = table_scene(**options)
    search = SegmentationConfig(search=ObjectSearchOptions(iterations=iterations))
    result = find_object(scene, starting_points(scene, 8000, 0), 0, options=search)
    assert isinstance(result, NoObject)
    assert any(part in result.reason for part in reason.split("|")), result.reason


@pytest.mark.slow
def test_an_object_beside_the_scenes_centre_is_found_whole() -> None:
    scene, truth = table_scene()
    result = find_object(_raised(scene, 1.1), starting_points(_raised(scene, 1.1), 8000, 0), 0)
    assert isinstance(result, FoundObject), result
    assert result.box[1][2] == pytest.approx(1.1 + 0.65, abs=0.06)  # beyond ObjectSearchOptions.near
    assert np.mean(overlaps(result.train + result.test, truth)) > 0.9


def _raised(scene: Scene, height: float) -> Scene:
    """Return the scene with everything in it raised above its centre."""

    def moved(view: View) -> View:
        pose = view.camera.cam_from_world.copy()
        pose[:3, 3] -= pose[:3, 2] * height
        return replace(view, camera=replace(view.camera, cam_from_world=pose))

    return replace(scene, train=[*map(moved, scene.train)], test=[*map(moved, scene.test)])


@pytest.mark.slow
def test_a_person_may_say_where_the_object_lies() -> None:
    """Check that of two objects the one in the box is found."""
    scene, truth = table_scene(copies=2)
    box = np.array([[-0.55, 0.1, TABLE], [0.55, 1.2, 0.8]])
    result = find_object(scene, starting_points(scene, 8000, 0), 0, box=box)
    assert isinstance(result, FoundObject), result
    both = [mask > 127 for mask in result.train + result.test]
    inside = [float((mask & true).sum() / mask.sum()) for mask, true in zip(both, truth, strict=True)]
    covered = [float((mask & true).sum() / true.sum()) for mask, true in zip(both, truth, strict=True)]
    assert np.mean(inside) > 0.93 and 0.35 < np.mean(covered) < 0.75
    assert result.box[0][1] > 0 and result.box[1][1] < 1.2
