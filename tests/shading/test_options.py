"""Options of the shading reach the functions that they are for: another value gives the expected other result."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from mgsr.config.expert import (
    BilateralOptions,
    DetailOptions,
    EnvironmentFitOptions,
    EnvironmentOptions,
    FlashOptions,
    LightOptions,
    ObservationOptions,
    OcclusionOptions,
    PhotometricOptions,
    ResidualOptions,
    ShadingOptions,
    ShadingPass,
)
from mgsr.geometry.mesh import Mesh
from mgsr.shading.ambient_occlusion import estimate_occlusion
from mgsr.shading.light_estimate import LightEstimate, estimate_light
from mgsr.shading.light_kind import LightKind
from mgsr.shading.light_models import EnvironmentLight, FlashLight
from mgsr.shading.photo_set import PhotoSet
from mgsr.shading.photometric_refinement import refine_photometrically
from mgsr.shading.photometric_residual import photometric_residual
from mgsr.shading.shape_from_shading import shape_from_shading
from tests.mesh.shapes import as_mesh, ball
from tests.shading.test_lighting import ball_and_wall
from tests.shading.test_lighting import camera as camera_above
from tests.shading.test_shape_from_shading import RADIUS, flash, photographs, rippled

UNSEEN = 999  # least number of observations that no point has


@pytest.fixture(scope="module")
def photos() -> PhotoSet:
    return PhotoSet(photographs(rippled(), flash, side=48))


@pytest.fixture(scope="module")
def smooth() -> Mesh:
    return as_mesh(ball(RADIUS))


def observed(photos: PhotoSet, mesh: Mesh, options: ObservationOptions) -> np.ndarray:
    """Return the number [V] of observations of each vertex."""
    changed = replace(photos, options=options)
    return changed.observer(changed.pixel_on(mesh)).observe(mesh).counts


def test_observations(photos: PhotoSet, smooth: Mesh) -> None:
    usual = observed(photos, smooth, ObservationOptions())
    assert observed(photos, smooth, ObservationOptions(count=3)).max() == 3 < usual.max()
    for fewer in (ObservationOptions(min_cosine=0.9), ObservationOptions(clipped=0.3)):
        assert observed(photos, smooth, fewer).sum() < 0.8 * usual.sum()


def kind(photos: PhotoSet, mesh: Mesh, options: LightOptions) -> LightKind:
    return estimate_light(mesh, photos, 0.85, LightEstimate(), options).kind


def test_the_choice_of_the_light(photos: PhotoSet, smooth: Mesh) -> None:
    assert kind(photos, smooth, LightOptions()) is LightKind.FLASH
    assert kind(photos, smooth, LightOptions(flash=FlashOptions(min_observations=UNSEEN))) is not LightKind.FLASH


def test_normals_under_a_flash(photos: PhotoSet, smooth: Mesh) -> None:
    observer = photos.observer(photos.pixel_on(smooth))
    observations = observer.observe(smooth)

    def confidence(options: FlashOptions) -> np.ndarray:
        return FlashLight(observer, smooth, observations, options).explain(smooth).confidence

    usual = confidence(FlashOptions())
    assert (confidence(FlashOptions(half_confidence=0.3)) > usual)[usual > 0].all()
    assert not confidence(FlashOptions(min_observations=UNSEEN)).any()


def test_the_fit_of_the_environment_map(photos: PhotoSet, smooth: Mesh) -> None:
    options = EnvironmentOptions(fit=EnvironmentFitOptions(height=8))
    found = EnvironmentLight(photos.observer(photos.pixel_on(smooth)), options).environment(smooth)
    assert found.light.shape == (8, 16)


def test_occlusion(photos: PhotoSet) -> None:
    """Check that the visible share of the sky is a multiple of the share of one ray."""
    whole, pixel = ball_and_wall().mesh, 0.01
    for rays in (4, 16):
        seen = estimate_occlusion(whole, photos.photographs, pixel, options=OcclusionOptions(rays=rays)).sky_visibility
        assert np.allclose(seen * rays, np.round(seen * rays), atol=1e-3) and 0 < np.mean(seen < 1) < 1


def test_irradiance() -> None:
    whole = ball_and_wall()
    brighter = replace(whole, options=replace(whole.options, dimmest=0.5)).seen_by(camera_above())
    assert brighter.min() == round(255 * 0.5 ** (1 / 2.4)) > whole.seen_by(camera_above()).min()


MOVES: list[tuple[str, Callable[[Mesh, PhotoSet], Mesh]]] = [
    ("no rounds", lambda mesh, photos: refine_photometrically(mesh, photos, 8.0, options=PhotometricOptions(rounds=0))),
    (
        "no observations",
        lambda mesh, photos: refine_photometrically(
            mesh, photos, 8.0, options=PhotometricOptions(details=DetailOptions(min_observations=UNSEEN))
        ),
    ),
    ("no limit", lambda mesh, photos: refine_photometrically(mesh, photos, 8.0, options=PhotometricOptions(limit=0.0))),
]


@pytest.mark.parametrize("move", [move for _, move in MOVES], ids=[name for name, _ in MOVES])
def test_photometric_refinement(move: Callable[[Mesh, PhotoSet], Mesh], photos: PhotoSet, smooth: Mesh) -> None:
    moved = move(smooth, photos)
    np.testing.assert_allclose(moved.vertices, smooth.vertices, atol=1e-6)
    usual = refine_photometrically(smooth, photos, 8.0).vertices
    assert np.abs(usual - smooth.vertices).max() > 1e-3


def test_the_photometric_residual(photos: PhotoSet, smooth: Mesh) -> None:
    light = estimate_light(smooth, photos, 0.85, LightEstimate()).model
    assert light is not None

    def residual(options: ResidualOptions) -> np.ndarray:
        return photometric_residual(smooth, photos, light, options)

    assert residual(ResidualOptions(forgiven=0.0, surface_error=0.0)).sum() > residual(ResidualOptions()).sum()
    assert not residual(ResidualOptions(details=DetailOptions(min_observations=UNSEEN))).any()


def test_shape_from_shading(photos: PhotoSet, smooth: Mesh) -> None:
    light = estimate_light(smooth, photos, 0.85, LightEstimate())

    def moved(options: ShadingOptions, work: ShadingPass) -> float:
        found = shape_from_shading(smooth, photos, light, {LightKind.FLASH: (work,)}, options=options)
        return float(np.abs(found.vertices - smooth.vertices).mean())

    work = ShadingPass(edge=2.0, rounds=1, reach=20.0)
    assert moved(ShadingOptions(max_faces=1000), work) != moved(ShadingOptions(), work)
    still = ShadingOptions(bilateral=BilateralOptions(rounds=0, steps=0))
    only_filter = ShadingPass(edge=2.0, rounds=0, reach=20.0, bilateral_angle=17.0)
    assert moved(still, only_filter) < 1e-9 < moved(ShadingOptions(), only_filter)
