"""Normals from an environment map, on a ball whose normals are known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import trimesh

from mgsr.config.expert import EnvironmentOptions
from mgsr.geometry.mesh import Mesh
from mgsr.shading.environment_normals import normals_from_environment
from mgsr.shading.observations import Observations

VIEWS, NOISE = 16, 0.02


def ball() -> Mesh:
    shape = trimesh.creation.icosphere(4)
    return Mesh(np.asarray(shape.vertices), np.asarray(shape.faces, np.int64))


def observed(normals: np.ndarray, light: Callable[[np.ndarray], np.ndarray]) -> Observations:
    """Observe points with unit normals [P,3] from random directions, with noise; each point has a paint of its own.

    light: the light [...] that comes from unit directions [...,3].
    """
    draw = np.random.default_rng(0)
    eyes = normals[:, None] + 0.8 * draw.standard_normal((len(normals), VIEWS, 3))
    eyes /= np.linalg.norm(eyes, axis=-1, keepdims=True)
    cosines = (eyes * normals[:, None]).sum(axis=-1)
    mirrored = 2 * cosines[..., None] * normals[:, None] - eyes
    brightness = (
        draw.uniform(0.2, 0.6, (len(normals), 1)) + light(mirrored) + NOISE * draw.standard_normal(eyes.shape[:2])
    )
    weights = np.where(cosines > 0.5, cosines, 0)
    numbers = np.broadcast_to(np.arange(VIEWS), weights.shape)
    eyes, brightness, weights = (array.astype(np.float32) for array in (eyes, brightness, weights))
    return Observations(eyes, np.ones_like(weights), brightness, weights, numbers)


def lamps(directions: np.ndarray) -> np.ndarray:
    """Return the light of narrow lamps, which mirrors show sharply."""
    places = trimesh.creation.icosphere(1).vertices
    light: np.ndarray = np.exp(60 * (np.max(directions @ places.T, axis=-1) - 1))
    return light


def sky(directions: np.ndarray) -> np.ndarray:
    """Return the light of a wide, dim sky."""
    light: np.ndarray = 0.03 * (1 + directions[..., 2])
    return light


def errors(light: Callable[[np.ndarray], np.ndarray], tilt: float, prior_deviation: float) -> np.ndarray:
    """Return the errors [V] in degrees of the target normals of a ball.

    tilt: degrees by which the mesh's own normals are wrong at most; they ripple.
    """
    mesh, options = ball(), EnvironmentOptions()
    true = mesh.vertices
    aside = np.cross(true, [0.3, 0.5, 0.8])
    own = true + np.tan(np.radians(tilt)) * np.sin(9 * true[:, :1]) * aside / np.linalg.norm(
        aside, axis=1, keepdims=True
    ).clip(1e-9)
    own /= np.linalg.norm(own, axis=1, keepdims=True)
    options = replace(options, normals=replace(options.normals, prior_deviation=prior_deviation))
    found = normals_from_environment(observed(true, light), own, mesh.laplacian, 2.0, np.zeros(len(own)), None, options)
    angles: np.ndarray = np.degrees(np.arccos(np.clip((found.normals * true).sum(axis=1), -1, 1)))
    return angles


USUAL = EnvironmentOptions().normals.prior_deviation


def test_lamps_correct_the_normals() -> None:
    """Check that ripples of 6 degrees, half of which exceed 4.2 degrees, shrink."""
    assert np.median(errors(lamps, 6.0, USUAL)) < 2.8


def test_a_wide_sky_does_not_spoil_good_normals() -> None:
    """Check that normals which the noise of the photographs hides stay those of the surface."""
    kept, moved = errors(sky, 0.0, USUAL), errors(sky, 0.0, 1e6)
    assert np.sqrt((kept**2).mean()) < 0.7 * np.sqrt((moved**2).mean())
