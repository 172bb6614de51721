"""The kernel that compares tilts of normals under a mirrored environment map."""

from __future__ import annotations

import numpy as np
import pytest

from mgsr.native import _mirrored, runtime
from mgsr.native.structs import MirroredObservations
from tests.oracles.tilt_costs import tilt_cost

POINTS, VIEWS, CELLS, OUTLIER = 150, 13, 16, 0.2
TILTS = np.tan(np.radians([-16.0, -4.0, 0.0, 12.0]))


def unit(random: np.random.Generator, *shape: int) -> np.ndarray:
    vectors = random.normal(size=(*shape, 3))
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def drawn_observations(random: np.random.Generator) -> MirroredObservations:
    """Draw observations; a third of the weights are 0, and the first point has none."""
    weights = np.maximum(random.uniform(-0.5, 1, (POINTS, VIEWS)), 0).astype(np.float32)
    weights[0] = 0
    return MirroredObservations(
        view_directions=unit(random, POINTS, VIEWS).astype(np.float32),
        brightness=random.random((POINTS, VIEWS), np.float32),
        weights=weights,
    )


def drawn_frames(random: np.random.Generator) -> np.ndarray:
    """Draw orthonormal frames [POINTS,3,3] float32."""
    return np.linalg.qr(random.normal(size=(POINTS, 3, 3)))[0].astype(np.float32)


def costs_of(observations: MirroredObservations, frames: np.ndarray, table: np.ndarray) -> np.ndarray:
    costs = np.full((len(frames), len(TILTS), len(TILTS)), np.nan, np.float32)
    _mirrored.tilt_costs(observations, table, frames, TILTS.astype(np.float32), OUTLIER, costs)
    return costs


@pytest.mark.usefixtures("kernel_settings_come_back")
def test_costs_are_those_of_single_tilts() -> None:
    random = np.random.default_rng(0)
    observations, frames = drawn_observations(random), drawn_frames(random)
    table = random.random((CELLS, CELLS, CELLS), np.float32)
    expected = np.empty((POINTS, len(TILTS), len(TILTS)))
    for point, (first, second, normal) in enumerate(frames.astype(float)):
        for i, across in enumerate(TILTS):
            for j, along in enumerate(TILTS):
                tilted = normal + across * first + along * second
                tilted /= np.linalg.norm(tilted)
                directions, brightness, weights = (values[point].astype(float) for values in observations)
                expected[point, i, j] = tilt_cost(directions, brightness, weights, tilted, table, OUTLIER)
    for isa in runtime.isas():
        runtime.set_isa(isa)
        costs = costs_of(observations, frames, table)
        # A direction within rounding of a cell's border may be read from the cell beside it.
        agrees = np.isclose(costs, expected, rtol=1e-3, atol=1e-4)
        assert agrees.mean() > 0.995, isa
        assert not costs[0].any() and np.isfinite(costs).all()


@pytest.mark.usefixtures("kernel_settings_come_back")
def test_costs_do_not_depend_on_the_threads() -> None:
    random = np.random.default_rng(1)
    observations, frames = drawn_observations(random), drawn_frames(random)
    table = random.random((CELLS, CELLS, CELLS), np.float32)
    runtime.set_threads(1)
    alone = costs_of(observations, frames, table)
    runtime.set_threads(3)
    np.testing.assert_array_equal(costs_of(observations, frames, table), alone)


def test_directions_that_are_not_unit_stay_inside_the_table() -> None:
    random = np.random.default_rng(2)
    observations = drawn_observations(random)
    observations = observations._replace(view_directions=observations.view_directions * 1e6)
    observations.view_directions[1] = np.nan
    assert np.isfinite(costs_of(observations, drawn_frames(random), np.ones((2, 2, 2), np.float32))).all()


def test_bad_sizes_are_named() -> None:
    random = np.random.default_rng(3)
    observations, frames = drawn_observations(random), drawn_frames(random)
    with pytest.raises(ValueError, match="table: expected a cube"):
        costs_of(observations, frames, np.ones((2, 2, 3), np.float32))
    with pytest.raises(ValueError, match="frames: expected one for each point"):
        costs_of(observations, frames[:-1], np.ones((2, 2, 2), np.float32))
    short = observations._replace(brightness=observations.brightness[:, :-1].copy())
    with pytest.raises(ValueError, match="brightness: expected 1950 values, got 1800"):
        costs_of(short, frames, np.ones((2, 2, 2), np.float32))
