"""Tests of the photometric residual under a flash: on a painted shell with a hole, and a mesh that covers it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from mgsr.config import MeshConfig
from mgsr.data.scene import View
from mgsr.geometry.mesh import Mesh
from mgsr.mesh.extract import take_steps
from mgsr.mesh.steps import mesh_steps
from mgsr.mesh.steps.step import StepContext
from mgsr.shading.light_estimate import LightEstimate
from mgsr.shading.light_kind import LightKind
from mgsr.shading.light_models import FlashLight
from mgsr.shading.photo_set import PhotoSet
from mgsr.shading.photometric_residual import photometric_residual
from tests.mesh.shapes import as_mesh, ball
from tests.shading.painted import PIXEL, flash_photographs, painted

POLE = np.array([0.36, 0.48, 0.8])
HOLE = 0.35  # radians around the pole
CONFIG = MeshConfig(photometric_reach=None)


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


def refined(views: list[View], config: MeshConfig) -> tuple[Mesh, LightEstimate, float]:
    """Take the steps of refinement on a full ball, and return the removed share of its area too."""
    context = StepContext([], PhotoSet(views), config, PIXEL, None, lambda: True)
    mesh, light, reports = take_steps(as_mesh(ball()), context, [step for step in mesh_steps() if step.refines])
    removed = reports["remove_contradicted"].outcome["removed_area"] if "remove_contradicted" in reports else 0.0
    return mesh, light, float(removed)


def test_photographs_differ_over_a_hole_alone(past_the_hole: list[View]) -> None:
    full = ball()
    mesh, photos = as_mesh(full), PhotoSet(past_the_hole)
    observer = photos.observer(PIXEL)
    flash = FlashLight(observer, mesh, observer.observe(mesh))
    differing, away = photometric_residual(mesh, photos, flash), angles(full.vertices)
    assert (differing[away < HOLE - 0.1] > 0.01).mean() > 0.95
    assert differing[away > HOLE + 0.15].max() < 0.01


def test_what_covers_a_hole_is_taken_out(past_the_hole: list[View]) -> None:
    found, light, removed = refined(past_the_hole, CONFIG)
    assert light.kind is LightKind.FLASH
    assert removed == pytest.approx((1 - np.cos(HOLE)) / 2, rel=0.3)
    rim = angles(found.vertices)
    assert HOLE - 0.1 < rim.min() < HOLE + 0.1


@pytest.mark.slow
def test_a_surface_without_holes_stays_whole() -> None:
    found, light, removed = refined(flash_photographs(ball(), patches), CONFIG)
    assert light.kind is LightKind.FLASH
    assert removed == 0 and len(found.faces) == len(ball().faces)


@pytest.mark.parametrize(
    "kept",
    [
        replace(CONFIG, photometric_residual=None),
        pytest.param(replace(CONFIG, close_holes=True), marks=pytest.mark.slow),
    ],
)
def test_all_is_kept_where_asked_for(past_the_hole: list[View], kept: MeshConfig) -> None:
    assert refined(past_the_hole, kept)[2] == 0
