"""Splats from starting points."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from mgsr.config import GaussianConfig, SurfelConfig
from mgsr.errors import TrainingError
from mgsr.gaussians.start import SH_CONSTANT, plane_normals, quats_from_normals, start_gaussians, start_surfels
from tests.training.ball import ball_points


def generator() -> torch.Generator:
    return torch.Generator().manual_seed(0)


def rotate(quats: np.ndarray, vector: list[float]) -> np.ndarray:
    """Rotate a vector by quaternions, with SciPy's rotation, which orders xyzw."""
    rotated: np.ndarray = Rotation.from_quat(quats[:, [1, 2, 3, 0]]).apply(vector)
    return rotated


def test_quats_take_z_to_the_normals() -> None:
    normals = np.vstack(
        [np.random.default_rng(0).normal(size=(50, 3)), [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.0, 0.0, -2.0]]]
    )
    unit = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    assert np.allclose(rotate(quats_from_normals(normals), [0, 0, 1]), unit, atol=1e-6)


def test_surfels_lie_on_the_surface() -> None:
    points = ball_points(500)
    config = SurfelConfig(start_opacity=0.1, start_scale=1.0)
    model = start_surfels(points.positions, points.normals, points.colors, config, generator())
    assert len(model) == 500
    assert points.normals is not None
    assert np.allclose(rotate(model.quats.numpy(), [0, 0, 1]), points.normals, atol=1e-5)
    assert torch.allclose(model.opacities(), torch.tensor(0.1))
    started = torch.from_numpy(points.colors / 255.0).float()
    assert torch.allclose(model.sh[:, 0] * SH_CONSTANT + 0.5, started, atol=1e-5)
    # 500 points on this ball: a spacing of about sqrt(area / 500)
    area = 4 * np.pi * 0.525**2
    assert 0.5 < float(model.scales().median()) / np.sqrt(area / 500) < 1.5


def test_missing_normals_come_from_the_neighbours() -> None:
    points = ball_points(500)
    model = start_surfels(points.positions, None, points.colors, SurfelConfig(), generator())
    along = np.abs((rotate(model.quats.numpy(), [0, 0, 1]) * points.normals).sum(axis=1))
    assert along.mean() > 0.99


def test_plane_normals_of_a_plane() -> None:
    positions = np.array([[0, 0, 1], [1, 0, 1], [0, 1, 1], [1, 1, 1.0]])
    normals = plane_normals(positions, np.array([[0, 1, 2, 3]] * 4))
    assert np.allclose(np.abs(normals), [0, 0, 1])


def test_gaussians_with_and_without_split() -> None:
    points = ball_points(50)
    both = start_gaussians(points.positions, None, points.colors, GaussianConfig(sh_degree=1), generator(), split=True)
    assert both.split
    assert torch.allclose(both.weights(), torch.tensor(GaussianConfig().start_weight))
    assert (both.sh_degree, both.refl_sh_degree) == (1, 3)
    plain = start_gaussians(points.positions, None, points.colors, GaussianConfig(), generator(), split=False)
    assert not plain.split
    assert set(plain.parameters()) == {"means", "quats", "log_scales", "opacity_logits", "sh"}


def test_thinning_is_seeded() -> None:
    points = ball_points(200)
    config = SurfelConfig(max_start=40)
    first, again = (
        start_surfels(points.positions, points.normals, points.colors, config, generator()) for _ in range(2)
    )
    assert len(first) == 40
    assert torch.equal(first.means, again.means)


def test_coinciding_points_get_a_size() -> None:
    positions = np.zeros((10, 3))
    positions[:5] += np.arange(5)[:, None]
    model = start_gaussians(positions, None, np.full((10, 3), 0.5), GaussianConfig(), generator(), split=True)
    assert torch.isfinite(model.log_scales).all()


@pytest.mark.parametrize(("count", "bad", "part"), [(3, False, "at least 4"), (10, True, "not finite")])
def test_unusable_points(count: int, bad: bool, part: str) -> None:
    positions = np.random.default_rng(0).normal(size=(count, 3))
    if bad:
        positions[0] = np.nan
    with pytest.raises(TrainingError, match=part):
        start_surfels(positions, None, np.zeros((count, 3)), SurfelConfig(), generator())
