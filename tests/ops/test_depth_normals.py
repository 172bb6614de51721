"""Normals of depth maps: against the oracle, and of a plane and a sphere."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch

from mgsr.data.camera import Camera
from mgsr.errors import TensorError
from mgsr.native import _image
from mgsr.ops.depth_normals import depth_to_normals
from tests.ops.variants import ISAS, variant
from tests.optional import present
from tests.oracles import depth_normals as oracle


def turned_camera(height: int, width: int) -> Camera:
    """Return a camera that is off-centre, in a general pose, with non-square pixels."""
    rotation, _ = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))
    pose = np.eye(4)
    pose[:3, :3] = rotation * np.sign(np.linalg.det(rotation))
    pose[:3, 3] = [0.1, -0.2, 2.5]
    K = np.array([[1.3 * width, 0, 0.4 * width], [0, 1.1 * width, 0.6 * height], [0, 0, 1.0]])
    return Camera(K, pose, width, height)


def rough_depth(height: int, width: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(height)
    depth = 2 + 0.05 * torch.rand(height, width, generator=generator)
    depth[torch.rand(height, width, generator=generator) > 0.95] = 0
    return depth


def gradients(
    function: Callable[[torch.Tensor], torch.Tensor], depth: torch.Tensor, v_normals: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    depth = depth.clone().requires_grad_()
    normals = function(depth)
    normals.backward(v_normals)
    return normals.detach(), present(depth.grad)


@pytest.mark.parametrize("isa", ISAS)
@pytest.mark.parametrize("size", [(3, 3), (7, 8), (9, 7), (33, 65), (70, 90)])
@pytest.mark.parametrize("with_alpha", [False, True])
def test_matches_the_oracle(isa: str, size: tuple[int, int], with_alpha: bool) -> None:
    camera, depth = turned_camera(*size), rough_depth(*size)
    v_normals = torch.randn(*size, 3, generator=torch.Generator().manual_seed(1))
    alpha = torch.rand(*size, generator=torch.Generator().manual_seed(2)) if with_alpha else None
    K, pose = torch.from_numpy(camera.K), torch.from_numpy(camera.cam_from_world)
    scale = 1.0 if alpha is None else alpha.double()[..., None]
    with variant(_image, isa):
        came = gradients(lambda d: depth_to_normals(d, camera, alpha), depth, v_normals)
    expected = gradients(lambda d: oracle.depth_to_normals(d, K, pose) * scale, depth.double(), v_normals.double())
    for a, b in zip(came, expected, strict=True):  # differences of float32 depths: 1e-7 of 2 beside steps of 0.05
        assert (a.double() - b).abs().max() <= 2e-5 * b.abs().max()


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (2, 9), (9, 2)])
def test_images_that_are_all_border_have_no_normals(size: tuple[int, int]) -> None:
    normals, v_depth = gradients(
        lambda d: depth_to_normals(d, turned_camera(*size)), torch.ones(size), torch.ones(*size, 3)
    )
    assert not normals.any()
    assert not v_depth.any()


def test_a_plane_facing_the_camera() -> None:
    camera = turned_camera(9, 12)
    normals = depth_to_normals(torch.full((9, 12), 2.0), camera)
    backward = torch.from_numpy(-camera.cam_from_world[2, :3]).float()
    torch.testing.assert_close(normals[1:-1, 1:-1], backward.expand(7, 10, 3), rtol=0, atol=1e-6)


def test_a_sphere() -> None:
    """Check that the normals of a sphere about the origin, of radius 0.5, are the directions of its points."""
    camera = turned_camera(200, 200)
    y, x = np.mgrid[:200, :200] + 0.5
    rays = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(camera.K).T
    center = camera.cam_from_world[:3, 3]
    along, squared = rays @ center, (rays**2).sum(-1)
    inside = along**2 - squared * (center @ center - 0.25)
    depth = np.where(inside > 0, (along - np.sqrt(np.maximum(inside, 0))) / squared, 0)
    normals = depth_to_normals(torch.from_numpy(depth).float(), camera).double().numpy()
    truth = (rays * depth[..., None] - center) @ camera.cam_from_world[:3, :3] / 0.5
    seen = np.linalg.norm(normals, axis=-1) > 0
    facing = -(truth @ camera.cam_from_world[:3, :3].T * rays).sum(-1) > 0.4
    assert (seen & facing).sum() > 2000
    assert ((normals * truth).sum(-1)[seen & facing] > np.cos(np.radians(1.0))).all()


def test_no_depth_no_normal_and_no_gradient() -> None:
    depth = rough_depth(20, 20)
    depth[10, 10], depth[5, 5], depth[3, 15] = -1, torch.nan, 0
    normals, v_depth = gradients(lambda d: depth_to_normals(d, turned_camera(20, 20)), depth, torch.ones(20, 20, 3))
    for y, x in ((10, 10), (5, 5), (3, 15)):
        assert not v_depth[y, x]
        for dy, dx in ((0, 0), (0, 1), (1, 0), (0, -1), (-1, 0)):
            assert not normals[y + dy, x + dx].any()
    assert torch.isfinite(normals).all()
    assert torch.isfinite(v_depth).all()


def test_same_bytes_for_any_thread_count() -> None:
    camera, depth = turned_camera(150, 70), rough_depth(150, 70)
    results = []
    for threads in (1, 2, 5):
        with variant(_image, threads=threads):
            results.append(gradients(lambda d: depth_to_normals(d, camera), depth, torch.ones(150, 70, 3)))
    for other in results[1:]:
        assert all(torch.equal(a, b) for a, b in zip(results[0], other, strict=True))


def test_bad_arguments_are_named() -> None:
    with pytest.raises(TensorError, match="depth"):
        depth_to_normals(torch.ones(9, 8), turned_camera(9, 9))
    with pytest.raises(TensorError, match="alpha"):
        depth_to_normals(torch.ones(9, 9), turned_camera(9, 9), torch.ones(9, 8))
