"""Extraction from views of shapes that are known."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from mgsr.config import ExpertConfig, Extractor, MeshConfig
from mgsr.config.expert import MeshOptions
from mgsr.data.silhouettes import Silhouette, signed_distance
from mgsr.errors import MeshError
from mgsr.geometry.mesh import Mesh
from mgsr.geometry.triangles import topology
from mgsr.mesh.extract import extract_mesh
from mgsr.mesh.points import OrientedPoints, front_views, missing_points
from mgsr.mesh.steps import mesh_steps
from mgsr.mesh.steps.step import MeshStep, StepContext, StepResult
from mgsr.mesh.views import SurfaceView
from mgsr.shading.light_estimate import LightEstimate
from mgsr.shading.light_kind import LightKind
from mgsr.shading.photo_set import PhotoSet
from tests.mesh.shapes import as_mesh, ball, cameras_around, joined, position_color, silhouettes_of, views_of
from tests.shading.test_shape_from_shading import Shade, flash, matte, photographs, rippled

RADIUS = 0.7
CONFIG = MeshConfig(poisson_depth=5)
BOTH = pytest.mark.parametrize("extractor", list(Extractor))


@pytest.fixture(scope="module")
def views() -> list[SurfaceView]:
    return views_of(ball(RADIUS), cameras_around(16))


def radial_error(mesh: Mesh) -> np.ndarray:
    errors: np.ndarray = np.abs(np.linalg.norm(mesh.vertices, axis=1) - RADIUS)
    return errors


@BOTH
def test_a_ball_comes_out(views: list[SurfaceView], extractor: Extractor) -> None:
    mesh = extract_mesh(views, replace(CONFIG, extractor=extractor))
    # A pixel covers 0.018 there. The TSDF reads the nearest pixel, so slanted surfaces become stairs.
    assert radial_error(mesh).mean() < {Extractor.POISSON: 0.002, Extractor.TSDF: 0.008}[extractor]
    assert topology(mesh).components == 1
    outwards = (mesh.normals * mesh.vertices).sum(1) / np.linalg.norm(mesh.vertices, axis=1)
    assert outwards.min() > 0.5
    # The TSDF of so few views has holes.
    assert trimesh.Trimesh(mesh.vertices, mesh.faces).volume > 0.8 * 4 / 3 * np.pi * RADIUS**3
    np.testing.assert_allclose(mesh.colors, position_color(mesh.vertices), atol=0.05)


def test_the_result_does_not_depend_on_the_run(views: list[SurfaceView]) -> None:
    first, second = (extract_mesh(views, CONFIG, PhotoSet(threads=count)) for count in (1, 2))
    np.testing.assert_array_equal(first.faces, second.faces)
    np.testing.assert_array_equal(first.vertices, second.vertices)
    np.testing.assert_array_equal(first.colors, second.colors)


@BOTH
def test_noise_of_the_depths_goes_from_the_facets(views: list[SurfaceView], extractor: Extractor) -> None:
    random = np.random.default_rng(0)
    noisy = [replace(view, depth=view.depth + random.normal(scale=0.004, size=view.depth.shape)) for view in views]

    def tilt(angle: float | None) -> float:
        """Return the mean angle to the ball's own normal, over the surface."""
        mesh = extract_mesh(noisy, replace(CONFIG, poisson_depth=6, extractor=extractor, bilateral_angle=angle))
        crosses, middles = mesh.face_crosses, mesh.vertices[mesh.faces].mean(axis=1)
        areas = np.linalg.norm(crosses, axis=1)
        cosines = (crosses * middles).sum(1) / (areas * np.linalg.norm(middles, axis=1))
        return float(np.average(np.arccos(np.clip(cosines, -1, 1)), weights=areas))

    unfiltered = tilt(None)
    assert tilt(CONFIG.bilateral_angle) < 0.6 * unfiltered
    assert tilt(0) == pytest.approx(unfiltered, rel=1e-12)  # fusion may give the facets in another order


@pytest.mark.parametrize(
    ("shade", "light"), [(matte, LightKind.UNKNOWN), pytest.param(flash, LightKind.FLASH, marks=pytest.mark.slow)]
)
def test_waves_go_unless_a_flash_has_told_them_from_shape(shade: Shade, light: LightKind) -> None:
    seen = photographs(ball(RADIUS), shade, side=64)
    rendered = views_of(rippled(), [view.camera for view in seen])
    config = replace(CONFIG, poisson_depth=7, min_alpha=0.3, bilateral_angle=None)
    kept, smoothed = (
        extract_mesh(rendered, replace(config, regression_angle=angle), photos=PhotoSet(seen), go_on=lambda: False)
        for angle in (None, 10.0)
    )
    assert kept.light is smoothed.light is light
    left = radial_error(smoothed).mean() / radial_error(kept).mean()
    assert left == 1 if light is LightKind.FLASH else left < 0.9


def test_floaters_in_one_view_vanish(views: list[SurfaceView]) -> None:
    spoiled = []
    for index, view in enumerate(views):
        depth = view.depth.copy()
        row, column = 40 + index % 5 * 4, 35 + index % 7 * 3
        depth[row : row + 5, column : column + 5] *= 0.85
        spoiled.append(replace(view, depth=depth))
    mesh = extract_mesh(spoiled, CONFIG)
    assert radial_error(mesh).max() < 0.02


def test_a_floater_in_all_views_is_small_and_goes(views: list[SurfaceView]) -> None:
    both = joined(ball(RADIUS), ball(0.04).apply_translation([0, 0, 0.95]))
    mesh = extract_mesh(views_of(both, cameras_around(16)), replace(CONFIG, min_piece=0.02))
    assert np.linalg.norm(mesh.vertices, axis=1).max() < 0.75


def test_nothing_stays_outside_the_silhouettes() -> None:
    cameras = cameras_around(16)
    fat = views_of(ball(RADIUS + 0.04), cameras)
    silhouettes = silhouettes_of(ball(RADIUS), cameras)
    free, held = (
        extract_mesh(fat, CONFIG),
        extract_mesh(fat, replace(CONFIG, consistency=None), PhotoSet(silhouettes=silhouettes)),
    )
    assert radial_error(free).mean() == pytest.approx(0.04, abs=0.004)
    # One pixel, 0.018, is forgiven, and 16 silhouettes touch a ball in 16 circles only.
    assert radial_error(held).mean() < 0.032


def test_a_mask_that_is_a_little_too_small_leaves_no_hole() -> None:
    cameras = cameras_around(16)
    views, silhouettes = views_of(ball(RADIUS), cameras), silhouettes_of(ball(RADIUS), cameras)
    inside = silhouettes[0].distance > 0
    notched = inside.copy()
    notched[: int(np.flatnonzero(inside.any(axis=1))[0]) + 4] = False  # four pixels, 0.07, are missing at the top
    wrong = [Silhouette(cameras[0], signed_distance(notched.astype(np.float32))), *silhouettes[1:]]
    mesh = extract_mesh(views, replace(CONFIG, silhouette_smoothing=None), PhotoSet(silhouettes=wrong))
    assert topology(mesh).boundary_edges == 0
    assert 0.03 < radial_error(mesh).max() < 0.08 and np.quantile(radial_error(mesh), 0.9) < 0.02


def test_one_wrong_mask_cuts_only_where_no_mask_may_dissent() -> None:
    cameras = cameras_around(16)
    views, silhouettes = views_of(ball(RADIUS), cameras), silhouettes_of(ball(RADIUS), cameras)
    smaller = silhouettes_of(ball(0.6 * RADIUS), cameras[:1])
    wrong, config = [*smaller, *silhouettes[1:]], replace(CONFIG, silhouette_smoothing=None)
    cut, whole = (extract_mesh(views, config, PhotoSet(silhouettes=wrong, dissent=dissent)) for dissent in (0, 1))
    assert radial_error(cut).max() > 0.05
    assert radial_error(whole).max() < 0.02
    two_wrong = [*smaller, *silhouettes_of(ball(0.6 * RADIUS), cameras[1:2]), *silhouettes[2:]]
    assert radial_error(extract_mesh(views, config, PhotoSet(silhouettes=two_wrong, dissent=1))).max() > 0.05


def test_what_was_never_seen_stays_open_unless_closed() -> None:
    above = [camera for camera in cameras_around(40) if camera.center[2] > 1.2]
    views = views_of(ball(RADIUS), above)
    mesh = extract_mesh(views, CONFIG)
    counts = topology(mesh)
    assert mesh.vertices[:, 2].min() > -0.65
    assert counts.holes == 1 and counts.boundary_edges > 10
    closed = extract_mesh(views, replace(CONFIG, close_holes=True))
    assert topology(closed).boundary_edges == 0


@pytest.mark.slow
def test_flanks_that_views_only_graze_come_from_the_start() -> None:
    above = [camera for camera in cameras_around(40) if camera.center[2] > 2.4]
    views, config = views_of(ball(RADIUS), above), replace(CONFIG, max_light_residual=None)
    points = np.asarray(ball(RADIUS).vertices)
    seen = np.any([((camera.center - points) * points).sum(1) > 0 for camera in above], axis=0)

    def missing(mesh: Mesh) -> float:
        """Return the share of the seen points that lie more than two pixels from the mesh."""
        return float((cKDTree(mesh.vertices).query(points[seen])[0] > 0.036).mean())

    start = as_mesh(ball(1.01 * RADIUS))
    expert = replace(ExpertConfig(), mesh=MeshOptions(supporting_views=1))
    alone, completed = extract_mesh(views, config), extract_mesh(views, config, start=start, expert=expert)
    assert missing(alone) > 0.1
    assert missing(completed) < 0.01
    assert radial_error(completed).max() < 0.012
    assert topology(completed).boundary_edges > 10, "what no camera sees stays open"
    supported = extract_mesh(views, config, start=start)
    assert missing(supported) > 0.05, "what fewer than three cameras see of the start is cut away"


def test_the_views_that_see_a_point_of_the_start() -> None:
    cameras = [camera for camera in cameras_around(400) if camera.center[2] > 2.94]
    start = as_mesh(ball(RADIUS))
    top = OrientedPoints(np.array([[0, 0, RADIUS]], np.float32), np.array([[0, 0, 1]], np.float32))
    others = missing_points(top, start, cell=0.02, reach=0.02)
    assert 0.02 < np.linalg.norm(others.positions - top.positions, axis=1).min() < 0.05
    seen = front_views(others, start, views_of(ball(RADIUS), cameras), gap=0.02)
    front = np.sum([((camera.center - others.positions) * others.normals).sum(1) > 0 for camera in cameras], axis=0)
    assert (seen == front).mean() > 0.98
    assert seen.max() == len(cameras)


def test_a_start_that_the_views_contradict_adds_nothing(views: list[SurfaceView]) -> None:
    mesh = extract_mesh(views, CONFIG, start=as_mesh(ball(1.4 * RADIUS)))
    assert radial_error(mesh).max() < 0.01


def test_thin_walls_keep_both_sides() -> None:
    plate = trimesh.creation.box([1.0, 1.0, 0.03])
    mesh = extract_mesh(views_of(plate, cameras_around(24)), replace(CONFIG, poisson_depth=7))
    middle = (np.abs(mesh.vertices[:, :2]) < 0.4).all(1)
    assert np.abs(np.abs(mesh.vertices[middle, 2]) - 0.015).max() < 0.005
    assert (np.sign(mesh.normals[middle, 2]) == np.sign(mesh.vertices[middle, 2])).all()


def test_masked_pixels_are_not_used(views: list[SurfaceView]) -> None:
    half = [replace(view, mask=np.zeros(view.depth.shape, bool)) for view in views[1:]] + views[:1]
    mesh = extract_mesh(half, CONFIG)
    towards = views[0].camera.center / np.linalg.norm(views[0].camera.center)
    assert (mesh.vertices @ towards).min() > 0


def test_decimation_reaches_the_count(views: list[SurfaceView]) -> None:
    mesh = extract_mesh(views, replace(CONFIG, max_faces=1000))
    assert 900 <= len(mesh.faces) <= 1000
    assert radial_error(mesh).mean() < 0.01


def test_empty_meshes_say_why(views: list[SurfaceView]) -> None:
    with pytest.raises(MeshError, match="expected at least two rendered views, got none"):
        extract_mesh([], CONFIG)
    with pytest.raises(MeshError, match=r"largest alpha is 0\.30"):
        extract_mesh([replace(view, alpha=0.3 * view.alpha) for view in views], CONFIG)
    with pytest.raises(MeshError, match=r"mesh\.radius=0\.1"):
        extract_mesh(views, replace(CONFIG, radius=0.1))
    with pytest.raises(MeshError, match="empty mesh"):
        extract_mesh(views, replace(CONFIG, extractor=Extractor.TSDF, radius=0.1))
    with pytest.raises(MeshError, match="empty mesh"):  # no voxel is seen by the two views that it takes
        extract_mesh(views[:1], replace(CONFIG, extractor=Extractor.TSDF))
    with pytest.raises(MeshError, match=r"normal of a surface view: expected the camera's shape \[96, 96, 3\]"):
        replace(views[0], normal=views[0].normal[:5])


def test_numbers_that_are_none_are_dropped(views: list[SurfaceView]) -> None:
    broken = []
    for view in views:
        depth, normal = view.depth.copy(), view.normal.copy()
        depth[40:45], normal[50:55] = np.nan, np.nan
        broken.append(replace(view, depth=depth, normal=normal))
    mesh = extract_mesh(broken, CONFIG)
    assert np.isfinite(mesh.vertices).all() and np.isfinite(mesh.colors).all()
    assert radial_error(mesh).max() < 0.02


def test_one_view_gives_what_it_sees(views: list[SurfaceView]) -> None:
    mesh = extract_mesh(views[:1], CONFIG)
    assert radial_error(mesh).mean() < 0.01


@dataclass(frozen=True)
class Shrink(MeshStep):
    """Shrink the mesh about the origin."""

    name = "shrink"
    factor: float = 0.5  # of its size

    def applies(self, context: StepContext, light: LightEstimate) -> bool:
        return self.factor < 1

    def run(self, mesh: Mesh, light: LightEstimate, context: StepContext) -> StepResult:
        return StepResult(mesh.moved(self.factor * mesh.vertices), light, {"factor": self.factor})


def test_a_step_is_added_by_one_line(views: list[SurfaceView]) -> None:
    """Check that a new step is run, and told with its outcome and time, without any other change."""
    plain, smaller = (extract_mesh(views, CONFIG, steps=steps) for steps in (mesh_steps(), (*mesh_steps(), Shrink())))
    np.testing.assert_array_equal(smaller.vertices, 0.5 * plain.vertices)
    assert list(smaller.steps) == [*plain.steps, "shrink"]
    report = smaller.steps["shrink"]
    assert report.outcome == {"factor": 0.5} and report.faces == len(plain.faces) and report.seconds >= 0
    assert "shrink" not in extract_mesh(views, CONFIG, steps=(*mesh_steps(), Shrink(factor=1.0))).steps


def test_steps_have_names_of_their_own() -> None:
    names = [step.name for step in mesh_steps()]
    assert len(set(names)) == len(names)
