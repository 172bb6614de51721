"""Tests of the correction for pixel footprints: stripes on a plate, whose mean over each pixel is known by calculus."""

from __future__ import annotations

import numpy as np
import pytest

from mgsr.data.camera import Camera
from mgsr.data.photograph import Photograph
from mgsr.geometry.mesh import Mesh
from mgsr.shading.observations import Observations, observe_photographs
from mgsr.shading.pixel_footprint import deconvolve
from tests.mesh.shapes import looking_at_origin
from tests.shading.painted import as_photograph

STRIPES = 1.6  # radians a pixel
STEPS = 90  # vertices along the plate's side


def plate(half: float) -> tuple[np.ndarray, np.ndarray]:
    """Build a square in the plane z = 0."""
    side = np.linspace(-half, half, STEPS)
    vertices = np.stack([*np.meshgrid(side, side), np.zeros((STEPS, STEPS))], axis=-1).reshape(-1, 3)
    index = np.arange(STEPS * STEPS).reshape(STEPS, STEPS)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    return vertices, np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)]).reshape(-1, 3)


def cameras() -> list[Camera]:
    """Return cameras straight above the plate, at three distances."""
    return [looking_at_origin(np.array([0.0, 0.0, distance])) for distance in (3, 3.3, 4)]


def stripes(column: np.ndarray) -> np.ndarray:
    """Return how bright a place is that is seen at this column."""
    return 0.5 + 0.3 * np.cos(STRIPES * column)


def striped(camera: Camera) -> Photograph:
    """Return a photograph of the stripes' mean over each pixel: the integral of a cosine."""
    mean = 0.5 + 0.3 * np.sinc(STRIPES / 2 / np.pi) * np.cos(STRIPES * (np.arange(camera.width) + 0.5))
    return as_photograph(camera, np.broadcast_to(mean, (camera.height, camera.width)))


def read(vertices: np.ndarray, faces: np.ndarray, photographs: list[Photograph]) -> Observations:
    return observe_photographs(Mesh(vertices, faces), photographs, gap=0.01)


def test_a_surface_that_is_known_reads_as_it_is() -> None:
    vertices, faces = plate(0.4)
    seen = cameras()
    photographs = [striped(camera) for camera in seen]
    true = np.stack([stripes(camera.project(vertices)[0][:, 0]) for camera in seen], axis=1)
    mixed = read(vertices, faces, photographs)
    clear = deconvolve(mixed, Mesh(vertices, faces), photographs, lambda number, some: true[some, number])
    inner = np.abs(vertices).max(axis=1) < 0.35
    assert (mixed.weights[inner] > 0).all()
    errors = [np.abs(each.brightness - true)[inner].mean() for each in (mixed, clear)]
    assert errors[0] > 0.03
    assert errors[1] < 0.15 * errors[0]


@pytest.mark.parametrize("level", [0.0, 0.7])
def test_where_pixels_miss_the_surface_they_say_nothing_of_it(level: float) -> None:
    """Check that on an even plate there is nothing to correct, at its borders neither."""
    vertices, faces = plate(0.2)
    photographs = [striped(camera) for camera in cameras()]
    mixed = read(vertices, faces, photographs)
    clear = deconvolve(mixed, Mesh(vertices, faces), photographs, lambda number, some: np.full(len(some), level))
    np.testing.assert_allclose(clear.brightness, mixed.brightness, atol=1e-5)


def test_only_the_vertices_that_are_looked_at_are_asked_for() -> None:
    vertices, faces = plate(0.4)
    away = np.concatenate([vertices, vertices - np.array([0.0, 0.0, 1.0])])
    both = np.concatenate([faces, faces + len(vertices)])
    photographs = [striped(camera) for camera in cameras()]
    asked: list[np.ndarray] = []

    def shown(number: int, some: np.ndarray) -> np.ndarray:
        asked.append(some)
        return np.full(len(some), 0.5)

    deconvolve(read(away, both, photographs), Mesh(away, both), photographs, shown, threads=1)
    assert len(asked) == len(photographs)
    assert all(len(vertices) / 2 < len(some) < 1.2 * len(vertices) for some in asked)
