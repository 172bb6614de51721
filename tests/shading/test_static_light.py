"""Shading by static light, against surfaces whose albedo and light are known."""

from __future__ import annotations

import numpy as np
import trimesh

from mgsr.config.expert import StaticLightOptions
from mgsr.geometry.mesh import Mesh
from mgsr.shading.ambient_occlusion import trace_hemispheres
from mgsr.shading.static_light import static_irradiance

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
    irradiance = static_irradiance(mesh, albedo * truth, trace_hemispheres(mesh, GAP))
    np.testing.assert_allclose(irradiance / irradiance.mean(axis=0), truth / truth.mean() * np.ones(3), atol=0.12)


def test_patches_under_even_light_are_no_shading() -> None:
    mesh, albedo = ball_with_patches()
    irradiance = static_irradiance(mesh, albedo, trace_hemispheres(mesh, GAP))
    np.testing.assert_allclose(irradiance, 1, atol=0.03)


def test_a_light_that_explains_too_little_is_even() -> None:
    mesh, albedo = ball_with_patches()
    sent = albedo * (1 + 0.8 * mesh.normals.astype(float) @ np.array([[0.6], [0.0], [0.8]]))
    demanding = StaticLightOptions(min_gain=1.0)
    irradiance = static_irradiance(mesh, sent, trace_hemispheres(mesh, GAP), options=demanding)
    np.testing.assert_allclose(irradiance, 1, atol=0.03)


def test_a_bowl_lights_itself() -> None:
    """Check a grey half ball seen from inside: with albedo a, places send out a / (2 - a) of the sky's light.

    Each sees half the sky, and the other half is the bowl itself.
    """
    whole, albedo = trimesh.creation.icosphere(5), 0.6
    bowl = trimesh.Trimesh(whole.vertices, whole.faces[whole.triangles_center[:, 2] < 0][:, ::-1])
    mesh = Mesh(np.asarray(bowl.vertices), np.asarray(bowl.faces))
    sent = np.full((len(mesh.vertices), 3), albedo / (2 - albedo))
    irradiance = static_irradiance(mesh, sent, trace_hemispheres(mesh, GAP))
    deep = mesh.vertices[:, 2] < -0.2
    np.testing.assert_allclose((sent / irradiance)[deep].mean(), albedo, rtol=0.04)
