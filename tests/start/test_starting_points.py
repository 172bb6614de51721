"""Starting points on a known ball, and on the hulls of the measurement scenes against their true meshes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy import ndimage
from scipy.spatial import cKDTree

from mgsr.config import DataConfig, Masks, make_config
from mgsr.config.expert import EnvironmentOptions
from mgsr.data.hull import Hull, carve, hull_surface, signed_field
from mgsr.data.readers import load_scene
from mgsr.data.scene import PointCloud, Scene, Similarity
from mgsr.data.silhouettes import view_silhouettes
from mgsr.geometry.mesh import Mesh
from mgsr.open3d_library import load_open3d
from mgsr.pipeline.example import find_example
from mgsr.shading.environment_residual import EnvironmentResidual, environment_residuals
from mgsr.shading.photo_set import PhotoSet
from mgsr.start import masked_surface
from mgsr.start.points import StartSource
from mgsr.start.starting_points import hull_points, starting_points
from mgsr.stereo.patch_match import DepthMap
from mgsr.stereo.photographs import StereoPhotographs
from tests.data.captures import BallCapture
from tests.optional import present
from tests.shading.balls import mirror_photographs, painted_photographs


@pytest.fixture
def ball_scene(tmp_path: Path) -> Scene:
    return load_scene(BallCapture(views=24).write_plain(tmp_path), DataConfig())


def test_hull_points_lie_on_the_ball(ball_scene: Scene) -> None:
    points = starting_points(ball_scene, 3000, seed=0)
    assert points.positions.shape == (3000, 3) and points.normals is not None
    assert points.source is StartSource.HULL
    user = ball_scene.user_from_scene.to_user(points.positions)
    radius = np.linalg.norm(user, axis=1)
    # Pixels are 0.037 wide at the ball; the hull of 21 views sticks out of it by as much.
    assert abs(np.median(radius) - 0.8) < 0.02 and radius.min() > 0.75 and radius.max() < 0.92
    np.testing.assert_allclose(np.linalg.norm(points.normals, axis=1), 1, atol=1e-6)
    assert ((points.normals * user).sum(axis=1) / radius).mean() > 0.95, "normals point outwards"
    assert (points.colors == [200, 100, 50]).all()


@pytest.mark.usefixtures("neither_bent_nor_moved")
def test_the_number_of_points_follows_the_photographs_pixels(ball_scene: Scene) -> None:
    few = replace(ball_scene, train=ball_scene.train[::3])
    usual, detailed = (
        starting_points(few, 300, seed=0, expert=make_config(overrides={"usual_pixels": pixels}).expert)
        for pixels in (1e6, 2000)
    )
    # A pixel is 0.037 wide at the ball, whose radius is 0.8; the hull of a few views sticks out of it.
    pixels = 4 * np.pi * (0.8 / 0.037) ** 2
    assert usual.surface_pixels == detailed.surface_pixels == pytest.approx(pixels, rel=0.15)
    assert len(usual.positions) == 300
    assert len(detailed.positions) == round(300 * present(detailed.surface_pixels) / 2000)


def test_points_lie_where_a_view_sees_the_surface(ball_scene: Scene) -> None:
    above = [view for view in ball_scene.train if view.camera.center[2] > 0.5 * np.linalg.norm(view.camera.center)]
    points = starting_points(replace(ball_scene, train=above), 1000, seed=0)
    to_camera = [view.camera.center - points.positions for view in above]
    assert points.normals is not None and points.surface is not None and len(above) > 3
    facing = np.max([(ways * points.normals).sum(axis=1) / np.linalg.norm(ways, axis=1) for ways in to_camera], axis=0)
    assert (facing > 0).mean() > 0.93, "only faces within a pixel of the rim may turn away"
    lowest = points.surface.vertices[:, 2].min()
    assert np.quantile(points.positions[:, 2], 0.01) > lowest + 0.2, "the cone below the ball is out of sight"


@pytest.mark.slow
def test_the_seed_decides(ball_scene: Scene) -> None:
    first, again, other = (starting_points(ball_scene, 500, seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.positions, again.positions)
    np.testing.assert_array_equal(first.colors, again.colors)
    assert (first.positions != other.positions).any()


def test_a_wrong_mask_of_a_found_object_cuts_nothing_off(ball_scene: Scene) -> None:
    first = ball_scene.train[0]
    half = present(first.alpha).copy()
    half[:, half.shape[1] // 2 :] = 0
    wrong = replace(ball_scene, train=[replace(first, alpha=half), *ball_scene.train[1:]])

    def least_radius(scene: Scene) -> float:
        """Return the least radius of the hull, in the ball's radii."""
        points = hull_points(scene, 4000, 0, 64)
        return float(np.linalg.norm(scene.user_from_scene.to_user(points.positions), axis=1).min()) / 0.8

    assert least_radius(wrong) < 0.3
    assert least_radius(replace(wrong, masks_found=True)) > 0.93


def test_the_hull_of_inexact_masks_holds_what_they_miss(ball_scene: Scene) -> None:
    """Check the hull of masks that are a pixel too small or too large by turns; a pixel is 0.037 at the ball."""
    grown = [ndimage.grey_erosion, ndimage.grey_dilation]
    rough = [
        replace(view, alpha=grown[number % 2](present(view.alpha), 3)) for number, view in enumerate(ball_scene.train)
    ]
    inexact = replace(ball_scene, train=rough, mask_error=1.0)
    assert inexact.masks_inexact

    def radius(scene: Scene) -> float:
        """Return the median radius of the hull."""
        points = hull_points(scene, 4000, 0, 64)
        return float(np.median(np.linalg.norm(scene.user_from_scene.to_user(points.positions), axis=1)))

    assert radius(replace(inexact, mask_error=0.0)) < 0.79 and 0.79 < radius(inexact) < 0.83


def test_without_masks_or_points_a_ball(tmp_path: Path) -> None:
    scene = load_scene(BallCapture().write_plain(tmp_path), DataConfig(masks=Masks.OFF))
    points = starting_points(scene, 4000, seed=0)
    radius = np.linalg.norm(points.positions, axis=1)
    assert points.normals is None and radius.max() <= 1 and points.source is StartSource.BALL
    assert abs((radius < 0.5).mean() - 1 / 8) < 0.03, "even through the volume"
    np.testing.assert_array_equal(points.positions, starting_points(scene, 4000, seed=0).positions)


@pytest.mark.parametrize("masks", [Masks.AUTO, Masks.OFF])
def test_the_share_of_the_work_that_is_done(tmp_path: Path, masks: Masks) -> None:
    """Check that progress is told on the way of both the hull and stereo, and never falls."""
    scene = load_scene(BallCapture(views=8).write_plain(tmp_path), DataConfig(masks=masks))
    reported: list[float] = []
    starting_points(scene, 500, seed=0, progress=reported.append)
    assert len(reported) >= 2 and reported == sorted(reported) and 0 < reported[0] < 1 and reported[-1] <= 1
    if masks is Masks.OFF:
        # Each view is searched, and then what has no contrast in it is continued.
        assert len(reported) == 2 * len(scene.train) and reported[-1] == pytest.approx(1)


def test_own_points_come_first_without_those_that_are_far_away_or_not_finite(tmp_path: Path) -> None:
    scene = load_scene(BallCapture().write_plain(tmp_path), DataConfig(masks=Masks.OFF))
    rng = np.random.default_rng(0)
    positions = np.r_[rng.normal(size=(100, 3)), [[1e6, 0, 0], [np.nan, 0, 0]]]
    colors = rng.integers(0, 256, (102, 3), dtype=np.uint8)
    found = starting_points(replace(scene, points=PointCloud(positions, colors)), 1000, seed=0)
    kept = [row for row in range(102) if (found.positions == positions[row]).all(axis=1).any()]
    assert len(kept) > 90 and max(kept) < 100, "isolated ones may go"
    np.testing.assert_array_equal(found.positions[: len(kept)], positions[kept])
    np.testing.assert_array_equal(found.colors[: len(kept)], colors[kept])
    assert found.source is StartSource.CAPTURE and np.isfinite(found.positions).all()
    assert np.linalg.norm(found.positions, axis=1).max() < 100


@pytest.mark.usefixtures("neither_bent_nor_moved")
def test_with_masks_the_surface_that_stereo_finds_comes_before_own_points(ball_scene: Scene) -> None:
    cloud = PointCloud(np.random.default_rng(0).normal(size=(1200, 3)), np.zeros((1200, 3), np.uint8))
    few = replace(ball_scene, train=ball_scene.train[::3])
    points = starting_points(replace(few, points=cloud), 600, seed=0)
    assert points.source is StartSource.HULL and points.surface is not None and len(points.positions) == 600
    np.testing.assert_array_equal(points.positions, starting_points(few, 600, seed=0).positions)


def test_coarse_to_fine_is_the_same_as_carving_all_voxels(ball_scene: Scene) -> None:
    silhouettes = view_silhouettes(ball_scene.train, 400)
    fine = carve(silhouettes, np.zeros(3), 1.05, 48)
    corner = fine.origin + np.stack(np.meshgrid(*[np.arange(48)] * 3, indexing="ij"), -1).reshape(-1, 3) * fine.voxel
    values, judged = signed_field(silhouettes, corner)
    exact = np.where(judged, values, -fine.voxel).reshape(48, 48, 48)
    np.testing.assert_array_equal(fine.field > 0, exact > 0)
    near = np.abs(exact) < 1.2 * fine.voxel
    np.testing.assert_allclose(fine.field[near], exact[near], atol=1e-6)


# Chamfer (mean of both ways, x1000 of the radius) of the hull that another program carved from the same masks.
HULLS = {"spot_soft": 2.75, "teapot_hdr": 3.02}


@pytest.mark.slow
@pytest.mark.parametrize("name", HULLS)
def test_hull_against_ground_truth(shared_data: Path, name: str) -> None:
    root = shared_data / "scenes" / name
    scene = load_scene(root, DataConfig())
    surface = hull_surface(carve(view_silhouettes(scene.train, 400), np.zeros(3), 1.05, 128))
    truth = trimesh.load_mesh(root / "mesh_gt.ply")
    ours = trimesh.Trimesh(scene.user_from_scene.to_user(surface[0]), surface[1], process=False)
    assert ours.volume > 0, "faces point outwards"
    meshes = (ours, truth)
    sparse = [trimesh.sample.sample_surface(mesh, 50_000, seed=0)[0] for mesh in meshes]
    dense = [trimesh.sample.sample_surface(mesh, 1_000_000, seed=1)[0] for mesh in meshes]
    chamfer = 500 * sum(cKDTree(dense[1 - i]).query(sparse[i])[0].mean() for i in (0, 1))
    assert chamfer < 1.1 * HULLS[name]


@pytest.mark.slow
def test_the_example_under_its_flash_begins_beside_its_surface() -> None:
    """Check that half of all points lie within a twentieth of a pixel of the surface."""
    root = find_example()
    scene = load_scene(root, DataConfig())
    points = starting_points(scene, 5000, seed=0)
    truth = trimesh.load_mesh(root / "mesh_gt.ply", process=False)
    places = scene.user_from_scene.to_user(points.positions)
    surface = load_open3d().t.geometry.RaycastingScene()
    surface.add_triangles(truth.vertices.astype(np.float32), truth.faces.astype(np.uint32))
    assert np.median(surface.compute_distance(places.astype(np.float32)).numpy()) < 0.0005


@pytest.fixture(scope="module")
def mirror() -> Scene:
    """Return a ball that mirrors a coloured room, and nothing else."""
    return Scene("mirror", Path(), "made here", mirror_photographs(96), [], None, Similarity(1.0, np.zeros(3)))


def off_the_ball(positions: np.ndarray) -> float:
    return float(np.abs(np.linalg.norm(positions, axis=1) - 0.7).mean())


@pytest.mark.usefixtures("neither_bent_nor_moved")
def test_a_mirror_is_not_carved(mirror: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    """Check that a mirror is not carved.

    What it mirrors moves across it as a pattern behind it would; as mirrored light it is explained best where the hull
    is.
    """
    compared: list[EnvironmentResidual] = []

    def compare(surfaces: Sequence[Mesh], photos: PhotoSet, options: EnvironmentOptions) -> list[EnvironmentResidual]:
        compared.extend(environment_residuals(surfaces, photos, options))
        return compared

    monkeypatch.setattr(masked_surface, "environment_residuals", compare)
    positions = starting_points(mirror, 2000, seed=0).positions
    outer, inner = (each.mesh.vertices for each in compared)
    assert off_the_ball(inner) > 3 * off_the_ball(outer), "stereo alone digs into it"
    assert compared[0].ratio < 0.8 * compared[1].ratio
    assert off_the_ball(positions) < 1.2 * off_the_ball(outer)


def roughened(mesh: Mesh, *rest: object, **more: object) -> Mesh:
    """Bend a mesh as wrong normals would."""
    noise = 0.01 * np.random.default_rng(0).standard_normal(len(mesh.vertices))
    return mesh.moved(mesh.vertices + noise[:, None] * mesh.double_normals)


def rounded(mesh: Mesh, *rest: object, **more: object) -> Mesh:
    """Bend a mesh to the true ball."""
    return mesh.moved(0.7 * mesh.vertices / np.linalg.norm(mesh.vertices, axis=1, keepdims=True))


@pytest.mark.parametrize(
    ("bend", "at_most", "stays"), [(roughened, 0.94, False), (roughened, 1000.0, True), (rounded, 0.94, True)]
)
def test_shape_from_shading_must_explain_the_brightness(
    mirror: Scene, monkeypatch: pytest.MonkeyPatch, bend: Callable[..., Mesh], at_most: float, stays: bool
) -> None:
    """Check that the surface bends only if one environment map then leaves clearly less residual."""
    bent: list[Mesh] = []
    moved: list[Mesh] = []

    def bend_once(mesh: Mesh, *rest: object, **more: object) -> Mesh:
        bent.append(bend(mesh))
        return bent[-1]

    def keep(mesh: Mesh, *rest: object, **more: object) -> Mesh:
        moved.append(mesh)
        return mesh

    monkeypatch.setattr(masked_surface, "shape_from_shading", bend_once)
    monkeypatch.setattr(masked_surface, "refine_photometrically", keep)
    expert = make_config(overrides={"max_bent_residual": at_most}).expert
    found = starting_points(mirror, 500, seed=0, expert=expert)
    assert (moved[0] is bent[0]) == stays and len(bent) == (2 if stays else 1)
    assert found.shiny is stays


def smaller_hull(cameras: object, maps: object, weights: object, hull: Hull, *rest: object) -> Mesh:
    """Find, in place of stereo, a surface 0.07 inside the hull's."""
    return Mesh(*hull_surface(replace(hull, field=hull.field - 0.07)))


def nothing_found(photographs: StereoPhotographs, *rest: object, **more: object) -> list[DepthMap]:
    empty = [np.zeros(image.shape[:2], np.float32) for image in photographs.images]
    return [DepthMap(each, np.zeros((*each.shape, 3), np.float32), each) for each in empty]


@pytest.mark.usefixtures("neither_bent_nor_moved")
def test_where_stereo_leaves_nothing_the_hull_stays(ball_scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    nothing = Mesh(np.empty((0, 3)), np.empty((0, 3), np.int64))
    for name in ("fuse_roughly", "fuse"):
        monkeypatch.setattr(masked_surface, name, lambda *given: nothing)
    user = ball_scene.user_from_scene.to_user(starting_points(ball_scene, 500, seed=0).positions)
    assert abs(np.median(np.linalg.norm(user, axis=1)) - 0.8) < 0.02


@pytest.mark.usefixtures("neither_bent_nor_moved")
def test_what_mirrors_nothing_is_carved(monkeypatch: pytest.MonkeyPatch) -> None:
    """Check that a painted ball is carved: a mirrored environment explains little of it, wherever its surface is."""
    views = painted_photographs(96)
    scene = Scene("painted", Path(), "made here", views, [], None, Similarity(1.0, np.zeros(3)))
    monkeypatch.setattr(masked_surface, "match_views", nothing_found)
    for name in ("fuse_roughly", "fuse"):
        monkeypatch.setattr(masked_surface, name, smaller_hull)
    radius = np.linalg.norm(starting_points(scene, 2000, seed=0).positions, axis=1)
    assert abs(np.median(radius) - 0.63) < 0.01
