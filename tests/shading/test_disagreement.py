"""Tests of the photometric residual under a flash: on a painted shell with a hole, and a mesh that covers it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from mgsr.config import MeshConfig
from mgsr.data.scene import View
from mgsr.mesh.refinement import Held, hold_against_photographs
from mgsr.shading.disagreement import disagreement
from mgsr.shading.kinds import ByFlash, Shot
from mgsr.shading.readings import linear_photographs
from mgsr.shading.refine import Light
from tests.mesh.shapes import ball
from tests.shading.painted import PIXEL, flash_photographs, painted

POLE = np.array([0.36, 0.48, 0.8])
HOLE = 0.35  # radians around the pole
CONFIG = MeshConfig(parallax_reach=None)


def patches(points: np.ndarray) -> np.ndarray:
    """Return a paint [...,3] in patches of a dozen pixels: what lies a pixel off does not look like the other side."""
    return painted(points / 4)


def angles(directions: np.ndarray) -> np.ndarray:
    from_pole: np.ndarray = np.arccos(np.clip(directions @ POLE / np.linalg.norm(directions, axis=1), -1, 1))
    return from_pole


def with_a_hole() -> trimesh.Trimesh:
    full = ball()
    return trimesh.Trimesh(full.vertices, full.faces[angles(full.triangles_center) > HOLE], process=False)


@pytest.fixture(scope="module")
def past_the_hole() -> list[View]:
    return flash_photographs(with_a_hole(), patches)


def held(views: list[View], config: MeshConfig) -> Held:
    full = ball()
    return hold_against_photographs(full.vertices, full.faces, views, [], config, None, lambda: True)


def test_photographs_differ_over_a_hole_alone(past_the_hole: list[View]) -> None:
    full = ball()
    shot = Shot(linear_photographs(past_the_hole), PIXEL, None)
    flash = ByFlash(shot, full.vertices, full.faces, *shot.read(full.vertices, full.faces))
    differing, away = disagreement(full.vertices, full.faces, past_the_hole, flash), angles(full.vertices)
    assert (differing[away < HOLE - 0.1] > 0.01).mean() > 0.95
    assert differing[away > HOLE + 0.15].max() < 0.01


def test_what_covers_a_hole_is_taken_out(past_the_hole: list[View]) -> None:
    found = held(past_the_hole, CONFIG)
    assert found.light is Light.FLASH
    assert found.opened == pytest.approx((1 - np.cos(HOLE)) / 2, rel=0.3)
    rim = angles(found.vertices)
    assert HOLE - 0.1 < rim.min() < HOLE + 0.1


def test_a_surface_without_holes_stays_whole() -> None:
    found = held(flash_photographs(ball(), patches), CONFIG)
    assert found.light is Light.FLASH
    assert found.opened == 0 and len(found.faces) == len(ball().faces)


@pytest.mark.parametrize("kept", [replace(CONFIG, disagreement=None), replace(CONFIG, close_holes=True)])
def test_all_is_kept_where_asked_for(past_the_hole: list[View], kept: MeshConfig) -> None:
    assert held(past_the_hole, kept).opened == 0
