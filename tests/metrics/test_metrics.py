"""Metrics where the answer is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from mgsr.data.camera import Camera
from mgsr.errors import MeshError, SceneError
from mgsr.geometry.mesh import Mesh
from mgsr.geometry.raycast import RayCaster
from mgsr.metrics.image import composited, image_metrics, psnr, psnr_after_gain, ssim
from mgsr.metrics.surface import normal_metrics, surface_metrics
from mgsr.metrics.truth import TrueSurface, load_truth, sample_surface
from tests.mesh.shapes import joined
from tests.metrics.scenes import blender_cameras


def ball(radius: float = 1.0) -> trimesh.Trimesh:
    sphere: trimesh.Trimesh = trimesh.creation.icosphere(subdivisions=5, radius=radius)
    return sphere


def camera(distance: float = 3.0, side: int = 96) -> Camera:
    """Return a camera on the negative z axis that looks at the origin; off-centre and with unequal focal lengths."""
    pose = np.eye(4)
    pose[2, 3] = distance
    return Camera(np.array([[110.0, 0, 45], [0, 100, 52], [0, 0, 1]]), pose, side, side)


def truth_of(mesh: trimesh.Trimesh) -> TrueSurface:
    labelled = sample_surface(Mesh(mesh.vertices, mesh.faces), 20_000, seed=3)
    return TrueSurface(Mesh(mesh.vertices, mesh.faces), labelled, np.full(20_000, 9), 1.0)


def test_ssim_and_psnr_are_scikit_images() -> None:
    random = np.random.default_rng(0)
    truth = random.random((40, 50, 3))
    image = np.clip(truth + 0.1 * random.normal(size=truth.shape), 0, 1)
    theirs = structural_similarity(
        truth, image, gaussian_weights=True, sigma=1.5, use_sample_covariance=False, channel_axis=2, data_range=1
    )
    assert ssim(truth, image) == pytest.approx(theirs, abs=1e-9)
    assert psnr(truth, image) == pytest.approx(peak_signal_noise_ratio(truth, image, data_range=1), abs=1e-9)


def test_equal_images_are_capped() -> None:
    image = np.random.default_rng(0).random((20, 20, 3))
    values = image_metrics(image, image)
    assert values == {"psnr": pytest.approx(100), "ssim": pytest.approx(1)}


def test_a_gain_costs_nothing() -> None:
    truth = np.random.default_rng(0).random((20, 20, 3)) * 0.5
    mask = np.ones((20, 20), bool)
    assert psnr_after_gain(truth, truth * [0.5, 0.7, 1.5], mask) > 90


def test_on_white_composites_straight_alpha() -> None:
    pixel = np.array([[[0.2, 0.4, 0.6, 0.5]]])
    np.testing.assert_allclose(composited(pixel), [[[0.6, 0.7, 0.8]]])
    np.testing.assert_allclose(composited(pixel[..., :3]), pixel[..., :3])


def test_a_larger_ball_is_its_distance_away() -> None:
    larger = ball(1.03)
    values = surface_metrics(Mesh(larger.vertices, larger.faces), truth_of(ball()))
    # Distances go to the nearest of a million samples, 1.8e-3 apart, which adds about 0.2% at this distance.
    assert values["accuracy"] == pytest.approx(0.03, rel=0.01)
    assert values["completeness"] == pytest.approx(0.03, rel=0.01)
    assert values["f_020"] == pytest.approx(0, abs=1e-6)
    assert values["normal_consistency_signed"] > 0.99


@pytest.mark.slow
def test_what_nobody_saw_does_not_count() -> None:
    truth = truth_of(joined(ball(), ball().apply_translation([0, 0, 4])))
    truth.view_counts[truth.labelled.points[:, 2] > 2] = 1
    wrong_there = joined(ball(), ball(1.3).apply_translation([0, 0, 4]))
    first = ball()
    # A million samples on two balls lie 5e-3 apart, so about half of that is found even where all is right.
    assert surface_metrics(Mesh(wrong_there.vertices, wrong_there.faces), truth)["accuracy"] < 4e-3
    assert surface_metrics(Mesh(first.vertices, first.faces), truth)["completeness"] < 4e-3


def test_a_truth_that_nobody_saw_has_no_completeness() -> None:
    truth = truth_of(ball())
    truth.view_counts[:] = 1
    values = surface_metrics(truth.mesh, truth)
    assert np.isnan(values["completeness"]) and np.isnan(values["normal_consistency"])


def test_turned_faces_show_in_the_signed_value(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mgsr.metrics.surface.DENSE", 100_000)
    mesh = ball()
    values = surface_metrics(Mesh(mesh.vertices, mesh.faces[:, ::-1]), truth_of(mesh))
    assert values["normal_consistency"] > 0.99
    assert values["normal_consistency_signed"] < -0.99


def test_an_empty_mesh_is_refused() -> None:
    with pytest.raises(MeshError, match="expected a mesh with faces"):
        surface_metrics(Mesh(np.zeros((0, 3)), np.zeros((0, 3), int)), truth_of(ball()))


def test_the_ray_caster_sees_a_ball_where_it_is() -> None:
    mesh, view = ball(), camera()
    hits = RayCaster(mesh.vertices, mesh.faces).cast(view)
    rows, columns = np.nonzero(hits.mask)
    x, y = (columns + 0.5 - 45) / 110, (rows + 0.5 - 52) / 100
    # |center + z (x, y, 1)| = 1 with the center 3 before the ball.
    square = x**2 + y**2 + 1
    exact = (3 - np.sqrt(np.maximum(9 - 8 * square, 0))) / square
    inner = 9 - 8 * square > 0.3
    np.testing.assert_allclose(hits.depth[rows, columns][inner], exact[inner], atol=3e-3)
    points = np.stack([x, y, np.ones_like(x)], 1) * hits.depth[rows, columns][:, None] - [0, 0, 3]
    assert ((points * hits.normal[rows, columns]).sum(1)[inner] > 0.99).all()
    assert (hits.depth[~hits.mask] == 0).all()


def test_visibility_of_points() -> None:
    mesh = ball()
    points = np.array([[0, 0, -1.0], [0, 0, 1], [0, 0, -5], [0.5, 0, -3.001], [9, 0, 0]])
    seen = RayCaster(mesh.vertices, mesh.faces).sees(camera(), points, gap=1e-3)
    # Front; hidden; behind the camera; at the camera's side; outside the image.
    np.testing.assert_array_equal(seen, [True, False, False, False, False])


def test_normal_error_of_a_turned_plane() -> None:
    plane = trimesh.creation.box([4, 4, 0.01])
    turned = plane.copy().apply_transform(trimesh.transformations.rotation_matrix(np.radians(7), [0, 1, 0]))
    values = normal_metrics(Mesh(turned.vertices, turned.faces), truth_of(plane), [camera()])
    assert values["normal_error"] == pytest.approx(7, abs=0.01)
    assert values["mask_iou"] == 1


def test_views_without_overlap_have_no_normal_error() -> None:
    away = ball(0.2).apply_translation([0.9, 0, 0])
    values = normal_metrics(Mesh(away.vertices, away.faces), truth_of(ball(0.2)), [camera()])
    assert np.isnan(values["normal_error"])
    assert values["mask_iou"] == 0


def test_a_scene_without_truth(tmp_path: Path) -> None:
    assert load_truth(tmp_path, []) is None
    trimesh.PointCloud(np.eye(3)).export(tmp_path / "mesh_gt.ply")
    with pytest.raises(SceneError, match=r"mesh_gt\.ply: expected a triangle mesh"):
        load_truth(tmp_path, [])


def test_visibility_by_ray_casting_is_the_stored_one(shared_data: Path, tmp_path: Path) -> None:
    scene = shared_data / "scenes" / "teapot_hdr"
    (tmp_path / "mesh_gt.ply").write_bytes((scene / "mesh_gt.ply").read_bytes())
    stored = load_truth(scene, [])
    counted = load_truth(tmp_path, blender_cameras(scene, "train"))
    assert stored is not None and counted is not None
    assert stored.radius == pytest.approx(1, abs=1e-6)
    # 2.8% of this surface is seen by fewer than two views.
    assert (counted.view_counts >= 2).mean() == pytest.approx((stored.view_counts >= 2).mean(), abs=0.003)
