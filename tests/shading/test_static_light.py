"""Shading by static light, against surfaces whose albedo and light are known."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from mgsr.config.expert import StaticLightOptions
from mgsr.geometry.mesh import Mesh
from mgsr.shading.ambient_occlusion import trace_hemispheres
from mgsr.shading.static_light import fit_static_light

GAP = 0.01


def ball_with_patches() -> tuple[Mesh, np.ndarray]:
    """Return a ball and its albedo [V,3]: patches of two colours, cut by planes that favour no direction."""
    shape = trimesh.creation.icosphere(5)
    mesh = Mesh(np.asarray(shape.vertices), np.asarray(shape.faces))
    odd = (np.floor(mesh.vertices * 2.3 + 0.37).sum(axis=1) % 2 == 0)[:, None]
    return mesh, np.where(odd, [0.7, 0.5, 0.2], [0.2, 0.3, 0.5])


def test_light_from_one_side_is_told_from_patches() -> None:
    mesh, albedo = ball_with_patches()
    truth = 1 + 0.8 * mesh.normals.astype(float) @ np.array([[0.6], [0.0], [0.8]])
    irradiance = fit_static_light(mesh, albedo * truth, trace_hemispheres(mesh, GAP)).irradiance
    np.testing.assert_allclose(irradiance / irradiance.mean(axis=0), truth / truth.mean() * np.ones(3), atol=0.12)


def test_patches_under_even_light_are_no_shading() -> None:
    mesh, albedo = ball_with_patches()
    irradiance = fit_static_light(mesh, albedo, trace_hemispheres(mesh, GAP)).irradiance
    np.testing.assert_allclose(irradiance, 1, atol=0.03)


def test_a_light_that_explains_too_little_is_even() -> None:
    mesh, albedo = ball_with_patches()
    sent = albedo * (1 + 0.8 * mesh.normals.astype(float) @ np.array([[0.6], [0.0], [0.8]]))
    demanding = StaticLightOptions(min_gain=1.0)
    irradiance = fit_static_light(mesh, sent, trace_hemispheres(mesh, GAP), options=demanding).irradiance
    np.testing.assert_allclose(irradiance, 1, atol=0.03)


def test_a_bowl_lights_itself() -> None:
    """Check a grey half ball seen from inside: with albedo a, places send out a / (2 - a) of the sky's light.

    Each sees half the sky, and the other half is the bowl itself.
    """
    whole, albedo = trimesh.creation.icosphere(5), 0.6
    bowl = trimesh.Trimesh(whole.vertices, whole.faces[whole.triangles_center[:, 2] < 0][:, ::-1])
    mesh = Mesh(np.asarray(bowl.vertices), np.asarray(bowl.faces))
    sent = np.full((len(mesh.vertices), 3), albedo / (2 - albedo))
    irradiance = fit_static_light(mesh, sent, trace_hemispheres(mesh, GAP)).irradiance
    deep = mesh.vertices[:, 2] < -0.2
    np.testing.assert_allclose((sent / irradiance)[deep].mean(), albedo, rtol=0.04)


@pytest.mark.slow
def test_the_environment_is_nowhere_negative_and_lights_alike() -> None:
    """Check light from one side against the irradiance that the environment's cells give, summed up one by one."""
    mesh, albedo = ball_with_patches()
    truth = 1 + 0.95 * mesh.normals.astype(float) @ np.array([[0.6], [0.0], [0.8]])
    light = fit_static_light(mesh, albedo * truth, trace_hemispheres(mesh, GAP))
    height = 16
    sky = light.environment(height)
    assert sky.shape == (height, 2 * height, 3) and sky.min() >= 0
    polar, azimuth = np.meshgrid(
        (np.arange(height) + 0.5) / height * np.pi, (np.arange(2 * height) + 0.5) / height * np.pi, indexing="ij"
    )
    flat = np.sin(polar)
    cells = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.cos(polar)], axis=-1).reshape(-1, 3)
    solid = flat.ravel() * (np.pi / height) ** 2
    cosines = np.maximum(mesh.normals @ cells.T, 0)
    irradiance = (cosines * solid) @ sky.reshape(-1, 3) / np.pi
    darkest = StaticLightOptions().darkest
    np.testing.assert_allclose(np.maximum(irradiance, darkest), light.irradiance, atol=0.05)
