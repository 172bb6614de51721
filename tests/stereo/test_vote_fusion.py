"""The kernels that gather depth maps' votes and fuse them under total variation, against the votes one by one and
general solvers of the same convex program."""

from __future__ import annotations

import numpy as np
import pytest

from mgsr.data.camera import Camera, pinhole_row
from mgsr.native import _fusion, runtime
from mgsr.native.structs import VotingMaps
from tests.mesh.shapes import cameras_around
from tests.oracles.vote_fusion import best_row, energy, least_energy, vote

BINS = 6
ROUNDS = 4000


def fused(votes: np.ndarray, shape: tuple[int, int, int], strength: float, rounds: int = ROUNDS) -> np.ndarray:
    field, voxels = np.zeros(shape, np.float32), np.arange(len(votes))
    _fusion.regularise(votes.astype(np.float32), voxels, np.ones(shape, np.float32), strength, rounds, field)
    return field


REACH, SOLID = 0.2, (0.25, 4.0)


def cameras_of_two_sizes() -> list[Camera]:
    """Return five cameras around the origin, and one that has it behind."""
    cameras = [each.resized(30 + 7 * i, 24) for i, each in enumerate(cameras_around(6, side=32))]
    pose = cameras[5].cam_from_world.copy()
    pose[2, 3] = -1.0
    return [*cameras[:5], Camera(cameras[5].K, pose, cameras[5].width, cameras[5].height)]


def voted(points: np.ndarray, cameras: list[Camera], depths: list[np.ndarray], weights: list[np.ndarray]) -> np.ndarray:
    votes = np.full((len(points), BINS), np.nan, np.float32)
    rows = np.stack([pinhole_row(camera) for camera in cameras])
    _fusion.vote(points, VotingMaps(cameras=rows, depths=depths, weights=weights), REACH, *SOLID, votes)
    return votes


def test_votes_are_those_one_by_one() -> None:
    random, cameras = np.random.default_rng(0), cameras_of_two_sizes()
    points = random.uniform(-1, 1, (5000, 3))
    depths = [random.uniform(2, 4, (each.height, each.width)).astype(np.float32) for each in cameras]
    weights = [np.maximum(random.uniform(-0.3, 1, each.shape), 0).astype(np.float32) for each in depths]
    expected = np.array([vote(point, cameras, depths, weights, REACH, SOLID, BINS) for point in points])
    assert (expected.sum(axis=0) > 50).all() and (expected.sum(axis=1) == 0).any()
    assert voted(points, cameras, depths, weights) == pytest.approx(expected, abs=1e-5)


def test_a_map_of_another_size_than_its_weights_is_named() -> None:
    cameras = cameras_of_two_sizes()[:1]
    with pytest.raises(ValueError, match="weights: expected the depths' size"):
        voted(np.zeros((1, 3)), cameras, [np.ones((3, 4), np.float32)], [np.ones((4, 3), np.float32)])
    with pytest.raises(ValueError, match="expected one for each camera"):
        voted(np.zeros((1, 3)), cameras, [], [])


def random_votes(count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).gamma(0.5, 1.0, (count, BINS))


@pytest.mark.parametrize("strength", [0.05, 0.4, 2.0])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_row_is_that_of_a_linear_program(axis: int, strength: float) -> None:
    votes = random_votes(9)
    found = fused(votes, [(9, 1, 1), (1, 9, 1), (1, 1, 9)][axis], strength).ravel()
    assert found == pytest.approx(best_row(votes, strength), abs=1 / (BINS * 24) + 1e-3)


@pytest.mark.parametrize("strength", [0.1, 0.6])
def test_a_grid_has_the_least_energy(strength: float) -> None:
    votes, shape = random_votes(60), (3, 4, 5)
    least = least_energy(votes, shape, strength)
    found = energy(fused(votes, shape, strength).astype(float), votes, strength)
    assert found < energy(fused(votes, shape, 1e-6).astype(float), votes, strength) - 0.1
    assert found == pytest.approx(least, rel=2e-3)


def test_without_variation_each_voxel_is_its_median() -> None:
    votes = random_votes(40)
    found = fused(votes, (1, 5, 8), 1e-6).ravel()
    sums = np.cumsum(votes, axis=1)
    edges = np.linspace(-1, 1, BINS + 1)
    below = [np.interp(value, edges, np.r_[0, each]) for value, each in zip(found, sums, strict=True)]
    assert below == pytest.approx(sums[:, -1] / 2, rel=2e-3)


def test_what_is_not_sought_stays_and_draws_the_rest() -> None:
    """Check that voxels without votes take the value of the fixed ends around; with a limit, no more than it."""
    field, most = np.zeros((5, 1, 1), np.float32), np.ones((5, 1, 1), np.float32)
    field[[0, 4]] = 0.8
    votes, voxels = np.zeros((3, BINS), np.float32), np.array([1, 2, 3])
    _fusion.regularise(votes, voxels, most, 0.5, ROUNDS, field)
    assert field.ravel() == pytest.approx([0.8] * 5, abs=1e-3)
    most[2] = -0.25
    _fusion.regularise(votes, voxels, most, 0.5, ROUNDS, field)
    assert field[[0, 4], 0, 0] == pytest.approx(0.8) and field[2, 0, 0] == pytest.approx(-0.25)


@pytest.mark.usefixtures("kernel_settings_come_back")
def test_threads_and_variants_give_the_same() -> None:
    votes, shape = random_votes(40 * 30 * 20), (40, 30, 20)
    first = fused(votes, shape, 0.4, 20)
    runtime.set_threads(5)
    assert (fused(votes, shape, 0.4, 20) == first).all()
    for isa in runtime.isas():
        runtime.set_isa(isa)
        assert fused(votes, shape, 0.4, 20) == pytest.approx(first, abs=1e-4)


@pytest.mark.parametrize(
    ("votes", "voxels", "strength", "said"),
    [
        ((2, BINS), [0, 24], 0.4, "voxels: expected numbers of voxels inside the grid"),
        ((2, BINS), [0, -1], 0.4, "voxels"),
        ((1, BINS), [0, 1], 0.4, "votes: expected a histogram for each voxel"),
        ((2, 0), [0, 1], 0.4, "votes"),
        ((2, BINS), [0, 1], 0.0, "strength"),
    ],
)
def test_bad_input_is_named(votes: tuple[int, int], voxels: list[int], strength: float, said: str) -> None:
    field = np.zeros((2, 3, 4), np.float32)
    with pytest.raises(ValueError, match=said):
        _fusion.regularise(np.zeros(votes, np.float32), np.array(voxels), np.ones_like(field), strength, 1, field)
