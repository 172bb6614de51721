"""Registration by parallax, on a painted ball with a dent that no outline shows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from mgsr.config import MeshConfig
from mgsr.config.expert import PhotometricOptions
from mgsr.data.camera import Camera
from mgsr.data.images import linear_to_srgb, srgb_to_linear
from mgsr.data.scene import Scene, Similarity, View
from mgsr.geometry.raycast import pixel_rays
from mgsr.geometry.vectors import dots
from mgsr.mesh.extract import extract_mesh
from mgsr.mesh.pixels import back_project
from mgsr.shading import photometric_refinement
from mgsr.shading.details import Details, ObservedMesh
from mgsr.shading.light_kind import LightKind
from mgsr.shading.light_models import FlashLight
from mgsr.shading.photo_set import PhotoSet
from mgsr.shading.photometric_refinement import refine_photometrically
from mgsr.start.starting_points import starting_points
from tests.mesh.shapes import as_mesh, ball, cameras_around, silhouettes_of, views_of
from tests.shading.painted import PIXEL, SIDE, Paint, flash_photographs, painted

RADIUS = 0.7
DENT = np.array([0.36, 0.48, 0.8])

Shine = Callable[[np.ndarray], np.ndarray]  # mirrored directions [...,3] -> linear light [...]


def true_radii(directions: np.ndarray) -> np.ndarray:
    """Return the radii [V] of the ball with a dent along unit directions [V,3].

    The dent is 1.5 pixels deep and a third of the radius wide.
    """
    angles = np.arccos(np.clip(directions @ DENT, -1, 1))
    radii: np.ndarray = RADIUS - 1.5 * PIXEL * np.exp(-((angles / 0.33) ** 2))
    return radii


def dented() -> trimesh.Trimesh:
    mesh = ball(1.0)
    vertices = mesh.vertices * true_radii(mesh.vertices)[:, None]
    return trimesh.Trimesh(vertices, mesh.faces, process=False)


def of_one_brightness(points: np.ndarray) -> np.ndarray:
    """Return a paint [...,3] of which the mean of the channels is the same everywhere, and the hue is not."""
    colors: np.ndarray = 0.5 + (painted(points)[..., :1] - 0.5) * np.array([0.8, -0.6, -0.2])
    return colors


def plain(points: np.ndarray) -> np.ndarray:
    return np.full(points.shape, 0.5)


def one_lamp(directions: np.ndarray) -> np.ndarray:
    light: np.ndarray = 0.08 * np.exp(5 * (directions @ np.array([0.6, 0.2, 0.77]) - 1))
    return light


def many_lamps(directions: np.ndarray) -> np.ndarray:
    """Return the light of lamps all around, some 20 degrees apart, so that highlights are as fine as paint."""
    lamps = trimesh.creation.icosphere(subdivisions=2).vertices
    light: np.ndarray = 0.1 * np.exp(80 * (np.max(directions @ lamps.T, axis=-1) - 1))
    return light


def nothing(directions: np.ndarray) -> np.ndarray:
    return np.zeros(directions.shape[:-1])


def photographs(mesh: trimesh.Trimesh, paint: Paint, shine: Shine = nothing, noise: float = 0) -> list[View]:
    """Photograph a mesh with paint and a gloss by 40 cameras around.

    noise: its deviation, of 255.
    """
    random, views = np.random.default_rng(0), []
    for index, seen in enumerate(views_of(mesh, cameras_around(40, side=SIDE))):
        rays = pixel_rays(seen.camera)
        mirrored = rays - 2 * (rays * seen.normal).sum(-1, keepdims=True) * seen.normal
        mirrored /= np.linalg.norm(mirrored, axis=-1, keepdims=True)
        light = srgb_to_linear(0.8 * paint(back_project(seen))) + shine(mirrored)[..., None]
        srgb = linear_to_srgb(light) * seen.alpha[..., None]
        image = np.clip(255 * srgb + random.normal(scale=noise, size=srgb.shape), 0, 255).round().astype(np.uint8)
        views.append(View(str(index), seen.camera, image, (255 * seen.alpha).astype(np.uint8)))
    return views


def photos_of(mesh: trimesh.Trimesh, views: list[View]) -> PhotoSet:
    """Return photographs with the silhouettes of a mesh."""
    return PhotoSet(views, silhouettes_of(mesh, [view.camera for view in views]))


def error(vertices: np.ndarray) -> float:
    """Return the mean of the pixels along the radius by which the vertices in the dent are off."""
    radii = np.linalg.norm(vertices, axis=1)
    directions = vertices / radii[:, None]
    inside = directions @ DENT > np.cos(0.4)
    return float(np.abs(radii - true_radii(directions))[inside].mean() / PIXEL)


@pytest.mark.parametrize(
    ("shine", "noise", "share"), [(nothing, 0, 0.15), pytest.param(one_lamp, 3, 0.3, marks=pytest.mark.slow)]
)
def test_a_dent_comes_out(shine: Shine, noise: float, share: float) -> None:
    truth, full = dented(), ball(RADIUS)
    views = photographs(truth, painted, shine, noise)
    found = refine_photometrically(as_mesh(full), photos_of(truth, views), 6.0)
    assert error(full.vertices) > 0.7
    assert error(found.vertices) < share * error(full.vertices)


@pytest.mark.parametrize("shine", [nothing, pytest.param(many_lamps, marks=pytest.mark.slow)])
def test_hue_tells_where_brightness_does_not(shine: Shine) -> None:
    """Check that hue tells the surface where brightness is the same everywhere.

    It does, too, where brightness tells wrongly, as white highlights do.
    """
    truth, full = dented(), ball(RADIUS)
    views = photographs(truth, of_one_brightness, shine, noise=1)
    found = refine_photometrically(as_mesh(full), photos_of(truth, views), 6.0)
    assert error(found.vertices) < 0.3 * error(full.vertices)


@pytest.mark.slow
def test_a_dent_comes_out_under_a_flash() -> None:
    """Check that parallax alone brings a dent out under a flash whose light is known."""
    truth, full = dented(), ball(RADIUS)
    photos = photos_of(truth, flash_photographs(truth, painted))
    observer = photos.observer(PIXEL)
    flash = FlashLight(observer, as_mesh(full), observer.observe(as_mesh(full)))
    found = refine_photometrically(as_mesh(full), photos, 6.0, flash)
    assert error(found.vertices) < 0.15 * error(full.vertices)


@pytest.mark.slow
def test_the_surface_of_a_capture_is_moved_where_outlines_hold_it() -> None:
    """Check that a surface is moved where outlines hold it.

    The rendered views lack the dent, as those of a branch that was trained too shortly.
    """
    truth, config = dented(), MeshConfig(poisson_depth=7, hull_margin=None, consistency=None)
    seen = photographs(truth, painted)
    rendered = views_of(ball(RADIUS), [view.camera for view in seen])
    masks = silhouettes_of(truth, [view.camera for view in seen])
    meshes = [extract_mesh(rendered, config, PhotoSet(seen, silhouettes)) for silhouettes in (masks, [])]
    moved, unmoved = meshes
    assert moved.light is LightKind.UNKNOWN and "photometric_refinement" in moved.steps
    assert "photometric_refinement" not in unmoved.steps
    assert error(moved.vertices) < 0.3 * error(unmoved.vertices)
    without = extract_mesh(rendered, replace(config, photometric_reach=None), PhotoSet(seen, masks))
    in_haste = extract_mesh(rendered, config, PhotoSet(seen, masks), go_on=lambda: False)
    assert not [each for each in (without, in_haste) if "photometric_refinement" in each.steps]


@pytest.mark.slow
def test_a_start_has_the_dent() -> None:
    """Check that a start has the dent to a ninth of a pixel; the hull carved by colours alone has it to a sixth."""
    views = photographs(dented(), painted)
    scene = Scene("ball", Path("ball"), "", views, [], None, Similarity(1.0, np.zeros(3)))
    assert error(starting_points(scene, 5000, 0).positions) < 0.13


def test_what_is_true_stays() -> None:
    truth = dented()
    views = photographs(truth, painted)
    found = refine_photometrically(as_mesh(truth), photos_of(truth, views), 6.0)
    assert np.linalg.norm(found.vertices - truth.vertices, axis=1).mean() / PIXEL < 0.1


def test_noise_does_not_add_up_over_the_rounds() -> None:
    truth = dented()
    photos = photos_of(truth, photographs(truth, painted, noise=15))
    few, many = (
        np.linalg.norm(found.vertices - truth.vertices, axis=1).mean() / PIXEL
        for rounds in (2, 10)
        for found in [refine_photometrically(as_mesh(truth), photos, 4.0, options=PhotometricOptions(rounds=rounds))]
    )
    assert many < 1.2 * few


def with_camera_errors(views: list[View], pixels: float) -> list[View]:
    """Turn each view's camera about its own axes, so that the image shifts by about `pixels` each way."""
    generator = np.random.default_rng(2)

    def turned(camera: Camera) -> Camera:
        turn = np.eye(4)
        turn[:3, :3] = Rotation.from_rotvec(generator.normal(scale=pixels / camera.K[0, 0], size=3)).as_matrix()
        return replace(camera, cam_from_world=turn @ camera.cam_from_world)

    return [replace(view, camera=turned(view.camera)) for view in views]


def test_camera_errors_roughen_an_accurate_surface_less() -> None:
    """Check that cameras which err by half a pixel tilt an accurate surface by little more than half as much.

    A dent still comes out."""
    truth, full = dented(), ball(RADIUS)
    views = photographs(truth, painted, noise=3)
    photos = photos_of(truth, views)
    shaken = replace(photos, views=with_camera_errors(views, 0.5))
    tilts = []
    for accurate in (False, True):
        found = refine_photometrically(as_mesh(truth), shaken, 6.0, accurate=accurate)
        cosines = dots(found.double_normals, as_mesh(truth).double_normals)
        tilts.append(float(np.degrees(np.arccos(np.clip(cosines, -1, 1))).mean()))
    assert tilts[1] < 0.6 * tilts[0]
    found = refine_photometrically(as_mesh(full), photos, 6.0, accurate=True)
    assert error(found.vertices) < 0.3 * error(full.vertices)


@pytest.mark.parametrize("noise", [0.5, 1.0, 2.0])
def test_the_agreement_of_the_halves_tells_the_share_of_noise(noise: float) -> None:
    """Check that the share is the variance of the signal over that of signal and noise, in both halves together."""
    mesh, generator = as_mesh(ball(RADIUS)), np.random.default_rng(0)
    surface, count = ObservedMesh(mesh, PIXEL), len(mesh.vertices)
    signal = generator.normal(size=count)
    one, other = (signal + noise * generator.normal(size=count) for _ in range(2))
    options = PhotometricOptions(agreement_reach=12.0)
    share = photometric_refinement._agreement(one, other, np.ones(count, bool), surface, options)
    assert share.mean() == pytest.approx(1 / (1 + noise**2 / 2), abs=0.05)


def test_unjudged_displacements_stay() -> None:
    mesh = as_mesh(ball(RADIUS))
    moves = np.ones(len(mesh.vertices))
    nowhere, surface = np.zeros(len(moves), bool), ObservedMesh(mesh, PIXEL)
    share = photometric_refinement._agreement(moves, -moves, nowhere, surface, PhotometricOptions())
    np.testing.assert_array_equal(share, 1)


def test_contours_of_found_masks_pull_less_on_what_is_true() -> None:
    truth = dented()
    given = photos_of(truth, photographs(truth, painted))
    wide = replace(given, silhouettes=[replace(one, distance=one.distance + 0.5) for one in given.silhouettes])
    found = replace(wide, masks_inexact=True)
    options = PhotometricOptions(rounds=2)
    meshes = [refine_photometrically(as_mesh(truth), photos, 6.0, options=options) for photos in (wide, found)]
    moves = [np.linalg.norm(mesh.vertices - truth.vertices, axis=1).mean() for mesh in meshes]
    assert moves[1] < 0.7 * moves[0]


@pytest.mark.slow
def test_noise_without_paint_tells_nothing() -> None:
    full = ball(RADIUS)
    views = photographs(full, plain, noise=3)
    found = refine_photometrically(as_mesh(full), photos_of(full, views), 6.0)
    assert np.linalg.norm(found.vertices - full.vertices, axis=1).mean() / PIXEL < 0.15


@pytest.mark.parametrize("known", [True, False])
def test_mirrored_detail_counts_less_where_it_is_known(known: bool) -> None:
    """Check that highlights in half of the photographs, of another parallax, are left out only if they are known."""
    surface, generator = ObservedMesh(as_mesh(ball(RADIUS)), PIXEL), np.random.default_rng(0)
    shape = len(surface.mesh.vertices), 10
    slope = generator.normal(size=shape).astype(np.float32)
    shines = np.arange(10) % 2 == 1
    mixed = np.where(shines, 2.0, -1.0) * slope + 0.1 * generator.normal(size=shape)
    mirrored = np.broadcast_to(np.where(known & shines, 3.0, 0.0), shape)
    details = Details(mixed.astype(np.float32), slope, mirrored.astype(np.float32), np.ones(shape, np.float32))
    target, _ = photometric_refinement._registered(details, surface, PhotometricOptions())
    error = abs(np.median(target) - 1)
    assert error < 0.1 if known else error > 0.5


def test_no_more_rounds_when_told_so() -> None:
    truth, full = dented(), ball(RADIUS)
    views = photographs(truth, painted)
    found = refine_photometrically(as_mesh(full), PhotoSet(views), 6.0, go_on=lambda: False)
    np.testing.assert_array_equal(found.vertices, full.vertices)
