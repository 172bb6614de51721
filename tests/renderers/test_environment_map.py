"""The environment map, against a plain float64 way of reflecting and looking up."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from mgsr.data.camera import Camera
from mgsr.gaussians.environment_map import EnvironmentMap
from mgsr.gaussians.reflector import Reflector
from mgsr.renderers.environment_map import octahedral, reflected_environment
from tests.gaussians.test_reflector import corner, corner_camera, sights
from tests.oracles import environment_map as oracle

SIDE = 64


def camera() -> Camera:
    """Return a camera that is off-centre and turned, with unequal focal lengths."""
    turn = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))[0]
    pose = np.eye(4)
    pose[:3, :3] = turn * np.sign(np.linalg.det(turn))
    pose[:3, 3] = [0.1, -0.2, 3.0]
    return Camera(np.array([[40.0, 0, 13.0], [0, 50.0, 9.0], [0, 0, 1.0]]), pose, 24, 16)


def normals(generator: np.random.Generator) -> np.ndarray:
    """Draw normals towards the camera, of odd lengths."""
    raw = generator.normal(size=(16, 24, 3)) * 0.6 - [0, 0, 1.5]
    in_world: np.ndarray = raw @ camera().cam_from_world[:3, :3] * generator.uniform(0.2, 1.0, size=(16, 24, 1))
    return in_world


def environment_map_directions(normal: np.ndarray) -> np.ndarray:
    """Return world directions [H,W,3] that the sight is mirrored to, by Householder's reflection of the ray itself."""
    view = camera()
    rows, columns = np.mgrid[: view.height, : view.width] + 0.5
    rays = np.stack([columns, rows, np.ones_like(rows)], axis=-1) @ np.linalg.inv(view.K).T
    rays = rays @ view.cam_from_world[:3, :3]
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    unit = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
    turned = np.eye(3) - 2 * unit[..., :, None] * unit[..., None, :]
    mirrored: np.ndarray = (turned @ rays[..., None])[..., 0]
    return mirrored


def unfolded(side: int) -> np.ndarray:
    """Return unit directions [S,S,3] of the texels' centres."""
    rows, columns = (np.mgrid[:side, :side] + 0.5) / side * 2 - 1
    z = 1 - np.abs(rows) - np.abs(columns)
    x = np.where(z < 0, (1 - np.abs(rows)) * np.sign(columns), columns)
    y = np.where(z < 0, (1 - np.abs(columns)) * np.sign(rows), rows)
    directions = np.stack([x, y, z], axis=-1)
    unit: np.ndarray = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    return unit


def glow(directions: np.ndarray) -> np.ndarray:
    """Return a smooth light of each direction [...,3], another one in each channel."""
    light: np.ndarray = 0.5 + 0.2 * directions + 0.2 * directions[..., [1, 2, 0]] * directions[..., [2, 0, 1]]
    return light


def light(scene: np.ndarray, held: np.ndarray) -> EnvironmentMap:
    return EnvironmentMap.of(np.moveaxis(np.stack([scene, held]), -1, 1), np.ones(3))


def assert_close(shown: torch.Tensor, expected: np.ndarray) -> None:
    """Check light from maps of 2.8 degrees a texel, read bilinearly.

    It is up to half a texel off along the octahedron's edges, where the map has creases and ends.
    """
    away = np.abs(shown.numpy() - expected)
    assert np.median(away) < 5e-4 and away.max() < 1e-2


def test_still_light_is_found_where_the_sight_is_reflected() -> None:
    normal = normals(np.random.default_rng(0))
    lit = light(glow(unfolded(SIDE)), np.zeros((SIDE, SIDE, 3)))
    shown = reflected_environment(lit, camera(), torch.tensor(normal).float())
    assert_close(shown, glow(environment_map_directions(normal)))


def test_light_on_the_camera_moves_with_it() -> None:
    normal = normals(np.random.default_rng(1))
    away = environment_map_directions(normal) @ camera().cam_from_world[:3, :3].T
    lit = light(np.zeros((SIDE, SIDE, 3)), glow(unfolded(SIDE)))
    shown = reflected_environment(lit, camera(), torch.tensor(normal).float())
    assert_close(shown, glow(away * [1, 1, -1]))


def test_a_surface_that_faces_the_camera_mirrors_the_maps_middle() -> None:
    K = camera().K * [[100.0], [100.0], [1.0]]
    K[:2, 2] = [13.0, 9.0]
    view = Camera(K, camera().cam_from_world, 24, 16)  # of a narrow field: every sight goes along the axis
    flash = np.zeros((SIDE, SIDE, 3))
    flash[SIDE // 2 - 2 : SIDE // 2 + 2, SIDE // 2 - 2 : SIDE // 2 + 2] = 0.9
    rows, columns = np.mgrid[: view.height, : view.width] + 0.5
    back = -np.stack([columns, rows, np.ones_like(rows)], axis=-1) @ np.linalg.inv(view.K).T
    normal = torch.tensor(back @ view.cam_from_world[:3, :3]).float()
    shown = reflected_environment(light(np.zeros_like(flash), flash), view, normal)
    assert np.abs(shown.numpy() - 0.9).max() < 1e-3


def test_gradients_are_the_plain_ways() -> None:
    logits = torch.randn(2 * 6 * 6 + 1, 3, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    pixels, view = torch.tensor([17, 3, 8, 0, 19]), camera().resized(5, 4)
    normal = torch.tensor(normals(np.random.default_rng(2))[:4, :5])
    K, pose = torch.tensor(view.K), torch.tensor(view.cam_from_world)

    def gradients(dtype: torch.dtype) -> tuple[torch.Tensor, ...]:
        held, turned = logits.to(dtype).requires_grad_(), normal.to(dtype).requires_grad_()
        if dtype == torch.float32:
            shown = reflected_environment(EnvironmentMap(held), view, turned, pixels)
        else:
            shown = oracle.look_up_environment_map(held[:-1].sigmoid().view(2, 6, 6, 3), turned, K, pose, pixels)
        return torch.autograd.grad(shown.square().sum(), (held, turned))

    for ours, true in zip(gradients(torch.float32), gradients(torch.float64), strict=True):
        assert (ours - true).abs().max() <= 1e-5 * true.abs().max()


def test_only_the_chosen_pixels_are_looked_at() -> None:
    normal = torch.tensor(normals(np.random.default_rng(3))).float()
    lit = light(glow(unfolded(8)), glow(unfolded(8))[::-1])
    chosen = np.random.default_rng(6).random((16, 24)) < 0.3
    pixels = torch.from_numpy(np.flatnonzero(chosen))
    whole, part = reflected_environment(lit, camera(), normal), reflected_environment(lit, camera(), normal, pixels)
    assert torch.allclose(part[chosen], whole[chosen], atol=1e-6)
    assert part[~chosen].abs().max() == 0


def test_nothing_there_gives_finite_light_and_gradients() -> None:
    normal = torch.zeros(16, 24, 3, requires_grad=True)
    lit = EnvironmentMap.uniform(8, 0.01)
    lit.logits.requires_grad_()
    reflected_environment(lit, camera(), normal).sum().backward()
    assert lit.logits.grad is not None
    assert normal.grad is not None and torch.isfinite(normal.grad).all() and torch.isfinite(lit.logits.grad).all()


@pytest.mark.parametrize("side", [1, 7, 64])
def test_octahedral_is_the_inverse_of_unfolding(side: int) -> None:
    places = octahedral(torch.tensor(unfolded(side)).reshape(-1, 3).T)
    rows, columns = (np.mgrid[:side, :side] + 0.5) / side * 2 - 1
    assert np.abs(places.numpy() - np.stack([columns, rows], axis=-1).reshape(-1, 2)).max() < 1e-9


def test_maps_come_back_from_their_own_values() -> None:
    maps = np.random.default_rng(4).uniform(0.01, 0.99, (2, 3, 5, 5))
    light = EnvironmentMap.of(maps, np.array([0.1, 0.5, 0.9]))
    assert np.abs(light.maps().numpy() - maps).max() < 1e-5
    assert np.abs(light.bounce().numpy() - [0.1, 0.5, 0.9]).max() < 1e-5


def test_a_reflector_mirrors_at_its_own_normals_and_once_more_where_it_meets_itself() -> None:
    lit = light(glow(unfolded(SIDE)), np.zeros((SIDE, SIDE, 3)))
    lit.reflector = Reflector(corner())
    lit.logits[-1] = torch.tensor([0.2, 0.5, 0.8]).logit()
    lit.logits.requires_grad_()
    view = corner_camera()
    shown = reflected_environment(lit, view)
    seen = lit.reflector.seen_by(view, torch.device("cpu"))
    wholly = seen.bounced_pixels[seen.bounced.any(dim=-1).all(dim=2).all(dim=1)]  # in all samples
    bounced = np.zeros(view.height * view.width, bool)
    bounced[wholly.numpy()] = True
    twice = bounced.reshape(view.height, view.width)
    assert 0.1 < twice.mean() < 0.9
    # Two mirrors at a right angle throw the sight back but for its part along their edge, y.
    back = sights(view) * [-1, 1, -1]
    share = np.array([0.2, 0.5, 0.8])
    assert np.abs(shown.detach().numpy() - share * glow(back))[twice].max() < 1e-2
    (gradient,) = torch.autograd.grad(shown[torch.from_numpy(twice)].sum(), lit.logits)
    reported = (glow(back)[twice] * share * (1 - share)).sum(axis=0)
    assert np.abs(gradient[-1].numpy() / reported - 1).max() < 1e-2
