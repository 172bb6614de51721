"""Zoomed photographs among those that share a lens, in scenes that COLMAP's own generator makes."""

from __future__ import annotations

import importlib
from typing import Any

import pytest

from mgsr.data.zoom_check import zoom_note

importlib.import_module("OpenImageIO")  # before pycolmap: the two don't bear the other order
pycolmap = pytest.importorskip("pycolmap")


def scene(cameras: int = 1, frames: int = 12) -> Any:
    pycolmap.set_random_seed(0)
    options = pycolmap.SyntheticDatasetOptions(
        num_rigs=cameras, num_cameras_per_rig=1, num_frames_per_rig=frames // cameras, num_points3D=200
    )
    return pycolmap.synthesize_dataset(options)


def zoom(image: Any, factor: float) -> None:
    """Move the points' pixels as a longer focal length does, about the principal point."""
    camera = image.camera
    middle = [camera.principal_point_x, camera.principal_point_y]
    for point in image.points2D:
        point.xy = middle + factor * (point.xy - middle)


def test_a_fixed_lens_is_no_news() -> None:
    assert zoom_note(pycolmap, scene()) == ()


def test_zoomed_photographs_are_counted_and_the_option_is_named() -> None:
    model = scene()
    for image in list(model.images.values())[:3]:
        zoom(image, 1.3)
    (note,) = zoom_note(pycolmap, model)
    assert note.startswith("3 of 12 photographs do not fit the lens") and note.endswith(
        "with `--set camera_per_image=on`"
    )


def test_lenses_of_their_own_may_differ() -> None:
    model = scene(cameras=12)
    assert len(model.cameras) == 12
    for image in list(model.images.values())[:3]:
        zoom(image, 1.3)
    assert zoom_note(pycolmap, model) == ()
