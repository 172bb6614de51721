"""Inexact masks, such as those of a found object, whose contours are less accurate than those of exact masks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import ndimage

from mgsr.config import MeshConfig
from mgsr.config.expert import ContourOptions
from mgsr.data.silhouettes import Silhouette
from mgsr.mesh.steps.fit_contours import FitContours
from mgsr.mesh.steps.photometric_refinement import PhotometricRefinement
from mgsr.mesh.steps.step import StepContext
from mgsr.shading.light_estimate import LightEstimate
from mgsr.shading.photo_set import PhotoSet
from tests.geometry.test_contours import RADIUS, covered
from tests.mesh.shapes import as_mesh, ball


def inaccurate(silhouettes: list[Silhouette]) -> list[Silhouette]:
    """Return silhouettes whose contours err by a third of a pixel, alike over about two pixels."""
    draw, found = np.random.default_rng(0), []
    for one in silhouettes:
        noise = ndimage.gaussian_filter(draw.standard_normal(one.distance.shape), 2.0)
        found.append(replace(one, distance=one.distance + 0.33 * noise / noise.std()))
    return found


def context_of(silhouettes: list[Silhouette], found: bool) -> StepContext:
    photos = PhotoSet([], silhouettes, masks_inexact=found)
    return StepContext([], photos, MeshConfig(), 0.02, None, lambda: True)


def test_contours_of_found_masks_leave_fewer_bumps() -> None:
    """Check the normals of a ball that is fitted to inaccurate contours; the ball gives its true normals."""
    silhouettes, start = inaccurate(covered(RADIUS, 24)), as_mesh(ball(RADIUS - 0.01))
    errors = {}
    for found in (False, True):
        mesh = FitContours().run(start, LightEstimate(), context_of(silhouettes, found)).mesh
        radii = np.linalg.norm(mesh.vertices, axis=1)
        cosines = (mesh.normals * mesh.vertices).sum(axis=1) / radii
        errors[found] = np.degrees(np.arccos(np.clip(cosines, -1, 1))).mean(), np.abs(radii - RADIUS).mean()
    assert errors[True][0] < 0.7 * errors[False][0]
    assert errors[True][1] < errors[False][1] < 0.01


def test_corrections_from_found_masks_fade_away_from_the_contours() -> None:
    """Check how far a ball moves at the two points that one camera sees farthest from its contour."""
    silhouettes, start = covered(RADIUS, 24)[:1], as_mesh(ball(RADIUS - 0.01))
    toward = silhouettes[0].camera.center / np.linalg.norm(silhouettes[0].camera.center)
    along = np.abs(start.vertices @ toward) / RADIUS
    moved = []
    for options in (ContourOptions(), ContourOptions(inexact_prior_weight=ContourOptions().prior_weight)):
        mesh = FitContours(options).run(start, LightEstimate(), context_of(silhouettes, True)).mesh
        moves = np.linalg.norm(mesh.vertices - start.vertices, axis=1)
        moved.append([moves[along > 0.8].mean(), moves[along < 0.1].mean()])
    (far, near), (far_without, near_without) = moved
    assert near > 0 and far / near < 0.3 * far_without / near_without, moved


def test_only_masks_that_contradict_each_other_do_not_hold_the_surface() -> None:
    silhouettes, light = covered(RADIUS, 3), LightEstimate(searches=1)
    contexts = [context_of(silhouettes, found) for found in (False, True)]
    assert all(PhotometricRefinement().applies(context, light) for context in contexts)
    contradictory = replace(contexts[1], photos=replace(contexts[1].photos, margin=0.9))
    assert not PhotometricRefinement().applies(contradictory, light)
