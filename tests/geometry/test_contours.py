"""Registration to outlines, against a ball whose silhouettes are known exactly."""

from __future__ import annotations

import io
from functools import cache

import numpy as np
import pytest
from PIL import Image

from mgsr.data.silhouettes import Silhouette, signed_distance
from mgsr.geometry.contours import contour_gaps, find_contour, fit_contours
from tests.mesh.shapes import as_mesh, ball, cameras_around

RADIUS = 0.7
FINE = 8


@cache
def covered(radius: float, count: int = 48) -> list[Silhouette]:
    """Return silhouettes of the ball from the share of each pixel that it covers."""
    mesh = ball(radius)
    caster, found = as_mesh(mesh).caster, []
    for camera in cameras_around(count):
        fine = caster.cast(camera.resized(camera.width * FINE, camera.height * FINE)).mask
        share = fine.reshape(camera.height, FINE, camera.width, FINE).mean((1, 3))
        found.append(Silhouette(camera, signed_distance(share)))
    return found


def test_outline_lies_on_the_rays_that_touch_the_ball() -> None:
    contour = find_contour(covered(RADIUS, 3)[1])
    camera = contour.camera
    flat = (contour.points - camera.K[:2, 2]) / camera.K[[0, 1], [0, 1]]
    local = np.column_stack([flat, np.ones(len(flat))])
    rays = local @ camera.cam_from_world[:3, :3]
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    passing = np.linalg.norm(np.cross(rays, camera.center), axis=1)  # from the ball's centre, the origin
    pixel = 3.0 / camera.K[0, 0]
    assert np.abs(passing - RADIUS).max() < 0.25 * pixel
    assert np.abs(passing - RADIUS).mean() < 0.08 * pixel


@pytest.mark.parametrize("compressed", [False, True])
def test_contours_of_binary_masks_err_by_a_sixth_of_a_pixel(compressed: bool) -> None:
    """Check the distances of binary masks against those of the covered shares, which are exact."""
    errors = []
    for exact in covered(RADIUS, 6):
        mask = (255 * (exact.distance > 0)).astype(np.uint8)
        if compressed:
            file = io.BytesIO()
            Image.fromarray(mask).save(file, "JPEG", quality=80)
            mask = np.asarray(Image.open(file))
        binary = signed_distance(mask / np.float32(255))
        near = np.abs(exact.distance) < 0.4
        errors.append((binary - exact.distance)[near])
        assert len(find_contour(Silhouette(exact.camera, binary)).points) > 0.8 * near.sum()
    error = np.concatenate(errors)
    assert np.sqrt((error**2).mean()) < 0.2 and abs(error.mean()) < 0.05


def test_no_pixel_of_a_thin_part_of_a_binary_mask_changes_sides() -> None:
    mask = np.zeros((20, 20), np.float32)
    mask[:, 8] = mask[5, 12:] = 1
    np.testing.assert_array_equal(signed_distance(mask) > 0, mask > 0)


@pytest.mark.parametrize("off", [-0.02, 0.02])
def test_a_ball_of_the_wrong_size_gets_the_right_one(off: float) -> None:
    mesh = ball(RADIUS + off)
    fitted = fit_contours(as_mesh(mesh), [find_contour(one) for one in covered(RADIUS)], smoothing=2.0)
    error = np.linalg.norm(fitted.vertices, axis=1) - RADIUS
    # A pixel is 0.024; some vertices are touched by no outline and follow the others.
    assert abs(error.mean()) < 0.001
    assert np.abs(error).mean() < 0.002


@pytest.mark.parametrize("off", [-0.0024, -0.0007, 0.0, 0.0007, 0.0024])
def test_gaps_are_told_to_a_small_part_of_a_pixel(off: float) -> None:
    """Check that gaps are told to a small part of a pixel, which is 0.024.

    Rays a quarter of it apart alone would make 0.003 of the least gap.
    """
    mesh = ball(RADIUS + off)
    gaps, touched = contour_gaps(as_mesh(mesh), [find_contour(one) for one in covered(RADIUS)])
    assert (gaps * touched).sum() / touched.sum() == pytest.approx(-off, abs=0.0002)


def test_what_no_outline_reaches_stays() -> None:
    mesh = ball(RADIUS - 0.3)  # far more than the search reaches
    fitted = fit_contours(as_mesh(mesh), [find_contour(one) for one in covered(RADIUS)], smoothing=2.0)
    np.testing.assert_allclose(fitted.vertices, mesh.vertices, atol=1e-12)
