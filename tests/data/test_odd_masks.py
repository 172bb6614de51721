"""Masks that leave out what others have: by mistake, or as they alone show how thin a part is."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from mgsr.config.expert import OddMaskOptions
from mgsr.data.camera import Camera
from mgsr.data.odd_masks import left_out_shares
from mgsr.data.scene import View
from mgsr.data.silhouettes import view_silhouettes
from tests.data.captures import look_at

SIDE = 128
# A plate that stands on its narrow side.
CORNERS = np.stack(np.meshgrid([-0.8, 0.8], [-0.02, 0.02], [-0.6, 0.6], indexing="ij"), axis=-1).reshape(-1, 3)
EDGE_ON = 15


@pytest.fixture(scope="module")
def plate() -> list[View]:
    """Provide views of a plate from both of its sides, and one along it."""
    turns = [*np.linspace(25, 155, 15), 0, *np.linspace(205, 335, 15)]
    K = np.array([[160.0, 0, SIDE / 2], [0, 160.0, SIDE / 2], [0, 0, 1]])
    views = []
    for index, turn in enumerate(np.radians(turns)):
        up = 0.0 if index == EDGE_ON else 0.8 * (-1) ** index
        camera = Camera(K, look_at(np.array([3 * np.cos(turn), 3 * np.sin(turn), up]), np.zeros(3)), SIDE, SIDE)
        outline = cv2.convexHull(camera.project(CORNERS)[0].astype(np.float32)).round().astype(np.int32)
        mask = cv2.fillConvexPoly(np.zeros((SIDE, SIDE), np.uint8), outline, (255,))
        views.append(View(f"{index:02d}", camera, np.zeros((SIDE, SIDE, 3), np.uint8), np.asarray(mask)))
    return views


def shares(views: list[View], options: OddMaskOptions = OddMaskOptions()) -> np.ndarray:
    return left_out_shares(views, view_silhouettes(views, SIDE), 0.3, options)


def test_a_view_along_a_plate_contradicts_nobody(plate: list[View]) -> None:
    assert shares(plate, OddMaskOptions(needed=0))[EDGE_ON] > 0.4, "it leaves out what the others have"
    assert shares(plate).max() < 0.3


def test_half_a_mask_contradicts_the_others(plate: list[View]) -> None:
    views = list(plate)
    half = np.array(views[7].alpha)
    half[:, : SIDE // 2] = 0
    views[7] = replace(views[7], alpha=half)
    assert 0.3 < shares(views)[7] < 0.7
    assert np.delete(shares(views), 7).max() < 0.3
