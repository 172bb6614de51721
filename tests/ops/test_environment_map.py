"""The environment map in every variant, against torch's own operations in float64."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
import pytest
import torch

from mgsr.data.camera import Camera
from mgsr.errors import TensorError
from mgsr.native import _environment_map
from mgsr.ops.environment_map import look_up_environment_map, look_up_samples
from tests.ops.test_depth_normals import turned_camera
from tests.ops.variants import ISAS, variant
from tests.optional import present
from tests.oracles import environment_map as oracle

Scene = tuple[torch.Tensor, torch.Tensor, torch.Tensor]  # maps, normals, gradients of the light


def scene(height: int, width: int, side: int) -> Scene:
    """Draw noise for the maps, and normals of all directions and lengths."""
    generator = torch.Generator().manual_seed(1000 * height + width)
    maps = torch.rand(2, side, side, 3, generator=generator)
    normals = torch.randn(height, width, 3, generator=generator) * torch.rand(height, width, 1, generator=generator)
    return maps, normals, torch.randn(height, width, 3, generator=generator)


def some_pixels(height: int, width: int) -> torch.Tensor:
    """Draw about 40% of the pixels, in any order."""
    chosen = np.flatnonzero(np.random.default_rng(0).random(height * width) < 0.4)
    return torch.from_numpy(np.random.default_rng(1).permutation(chosen))


def gradients(
    function: Callable[[torch.Tensor, torch.Tensor], torch.Tensor],
    maps: torch.Tensor,
    normals: torch.Tensor,
    v_light: torch.Tensor,
) -> Scene:
    maps, normals = maps.clone().requires_grad_(), normals.clone().requires_grad_()
    light = function(maps, normals)
    light.backward(v_light)
    return light.detach(), present(maps.grad), present(normals.grad)


def expected_of(scene: Scene, camera: Camera, pixels: torch.Tensor | None = None) -> Scene:
    """Return the light and gradients of the oracle, in float64."""
    K, pose = torch.from_numpy(camera.K), torch.from_numpy(camera.cam_from_world)
    doubles = [t.double() for t in scene]
    return gradients(lambda m, n: oracle.look_up_environment_map(m, n, K, pose, pixels), *doubles)


def samples_of(pixels: torch.Tensor, rows: int) -> torch.Tensor:
    """Draw samples [P,N,N,3] of all directions and lengths; a third have no weight, and a pixel may have none."""
    generator = torch.Generator().manual_seed(rows)
    samples = torch.randn(len(pixels), rows, rows, 3, generator=generator)
    return samples * (torch.rand(len(pixels), rows, rows, 1, generator=generator) > 0.3)


def sample_gradients(
    function: Callable[[torch.Tensor], torch.Tensor], maps: torch.Tensor, v_light: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    maps = maps.clone().requires_grad_()
    light = function(maps)
    light.backward(v_light)
    return light.detach(), present(maps.grad)


def expected_of_samples(
    parts: Scene, samples: torch.Tensor, camera: Camera, pixels: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the light and the maps' gradient of the oracle, in float64."""
    K, pose, size = torch.from_numpy(camera.K), torch.from_numpy(camera.cam_from_world), (camera.height, camera.width)
    maps, _, v_light = (t.double() for t in parts)
    return sample_gradients(lambda m: oracle.look_up_samples(m, samples.double(), K, pose, pixels, size), maps, v_light)


def assert_close(came: Sequence[torch.Tensor], expected: Sequence[torch.Tensor]) -> None:
    """Check light and gradients against the expected ones, with tolerances from float32's rounding.

    A float32 direction is off by some 3e-7, which is that times the side in texels, and so much of a step between
    texels of noise; gradients of short normals are as much larger as those are short.
    """
    for name, a, b in zip(("light", "maps", "normals")[: len(came)], came, expected, strict=True):
        assert (a.double() - b).abs().max() <= 2e-5 * b.abs().max(), name


@pytest.mark.parametrize("isa", ISAS)
@pytest.mark.parametrize("size", [(1, 1), (1, 7), (9, 8), (33, 65), (70, 40)])
@pytest.mark.parametrize("side", [1, 2, 7, 16])
@pytest.mark.parametrize("chosen", [False, True])
def test_matches_the_oracle(isa: str, size: tuple[int, int], side: int, chosen: bool) -> None:
    parts, camera = scene(*size, side), turned_camera(*size)
    pixels = some_pixels(*size) if chosen else None
    with variant(_environment_map, isa):
        came = gradients(lambda m, n: look_up_environment_map(m, n, camera, pixels), *parts)
    assert_close(came, expected_of(parts, camera, pixels))


@pytest.mark.parametrize("isa", ISAS)
@pytest.mark.parametrize("size", [(1, 1), (9, 8), (33, 65)])
@pytest.mark.parametrize("side", [1, 2, 16])
@pytest.mark.parametrize("rows", [1, 2, 3])
def test_samples_match_the_oracle(isa: str, size: tuple[int, int], side: int, rows: int) -> None:
    parts, camera, pixels = scene(*size, side), turned_camera(*size), some_pixels(*size)
    samples = samples_of(pixels, rows)
    with variant(_environment_map, isa):
        came = sample_gradients(lambda m: look_up_samples(m, samples, camera, pixels), parts[0], parts[2])
    assert_close(came, expected_of_samples(parts, samples, camera, pixels))


def test_one_sample_of_weight_1_is_a_normal() -> None:
    parts, camera, pixels = scene(33, 65, 16), turned_camera(33, 65), some_pixels(33, 65)
    unit = torch.nn.functional.normalize(parts[1], dim=-1)
    whole = look_up_environment_map(parts[0], unit, camera, pixels)
    shown = look_up_samples(parts[0], unit.view(-1, 1, 1, 3)[pixels], camera, pixels)
    assert (shown - whole).abs().max() < 1e-6


@pytest.mark.parametrize("isa", ISAS)
def test_a_large_map(isa: str) -> None:
    """Check a map of more texels than pixels, and several parts of the backward pass."""
    maps, normals, v_light = scene(70, 90, 200)
    smooth = torch.sin(torch.linspace(0, 6, 200))[:, None, None] + torch.linspace(0, 3, 200)[:, None]
    maps = torch.stack([smooth.expand(200, 200, 3), smooth.flip(0).expand(200, 200, 3)]).contiguous()
    with variant(_environment_map, isa):
        came = gradients(lambda m, n: look_up_environment_map(m, n, turned_camera(70, 90)), maps, normals, v_light)
    expected = expected_of((maps, normals, v_light), turned_camera(70, 90))
    for name, a, b in zip(("light", "maps", "normals"), came, expected, strict=True):
        # 3e-7 of the direction are 6e-5 texels of 200: so much of a texel's gradient goes to its neighbour.
        assert (a.double() - b).abs().mean() <= 1e-4 * b.abs().mean(), name


@pytest.mark.parametrize("isa", ISAS)
def test_normals_across_and_along_the_sight(isa: str) -> None:
    """Check surfaces seen edge on, straight on, and from behind; at the octahedron's seams, too."""
    camera = turned_camera(6, 40)
    rows, columns = torch.meshgrid(torch.arange(6) + 0.5, torch.arange(40) + 0.5, indexing="ij")
    pixels = torch.stack([columns, rows, torch.ones(6, 40)], dim=-1)
    rays = pixels.double() @ torch.from_numpy(np.linalg.inv(camera.K)).T
    rays = rays @ torch.from_numpy(camera.cam_from_world[:3, :3])
    straight = rays / rays.norm(dim=-1, keepdim=True)
    edge_on = torch.linalg.cross(straight, torch.tensor([0.3, -0.5, 0.8], dtype=torch.float64).expand_as(straight))
    maps, _, v_light = scene(6, 40, 16)
    for normals in (straight, -straight, edge_on, edge_on + 1e-3 * straight):
        with variant(_environment_map, isa):
            came = gradients(lambda m, n: look_up_environment_map(m, n, camera), maps, normals.float(), v_light)
        assert_close(came, expected_of((maps, normals.float(), v_light), camera))


@pytest.mark.parametrize("isa", ISAS)
def test_normals_without_length_are_finite_and_get_no_gradient(isa: str) -> None:
    maps, normals, v_light = scene(9, 12, 8)
    normals[::2] = 0
    with variant(_environment_map, isa):
        came = gradients(lambda m, n: look_up_environment_map(m, n, turned_camera(9, 12)), maps, normals, v_light)
    assert_close(came, expected_of((maps, normals, v_light), turned_camera(9, 12)))
    assert not came[2][::2].any()


@pytest.mark.parametrize("isa", ISAS)
@pytest.mark.parametrize("length", [1e-9, 1e-7, 1e-4, 1e4])
def test_very_short_and_long_normals(isa: str, length: float) -> None:
    maps, normals, v_light = scene(9, 12, 8)
    normals = length * torch.nn.functional.normalize(normals, dim=-1)
    with variant(_environment_map, isa):
        came = gradients(lambda m, n: look_up_environment_map(m, n, turned_camera(9, 12)), maps, normals, v_light)
    assert_close(came, expected_of((maps, normals, v_light), turned_camera(9, 12)))


@pytest.mark.parametrize("isa", ISAS)
def test_a_bad_normal_harms_no_other_pixel(isa: str) -> None:
    maps, normals, v_light = scene(5, 9, 8)
    with variant(_environment_map, isa):
        before = gradients(lambda m, n: look_up_environment_map(m, n, turned_camera(5, 9)), maps, normals, v_light)
        for bad in (torch.nan, torch.inf, 1e30):
            normals[2, 3, 1] = bad
            after = gradients(lambda m, n: look_up_environment_map(m, n, turned_camera(5, 9)), maps, normals, v_light)
            others = torch.ones(5, 9, dtype=torch.bool)
            others[2, 3] = False
            assert torch.equal(before[0][others], after[0][others]) and torch.isfinite(after[0]).all()
            assert torch.equal(before[2][others], after[2][others]) and torch.isfinite(after[1]).all()


def test_same_bytes_for_any_thread_count() -> None:
    parts, camera = scene(150, 170, 20), turned_camera(150, 170)
    for pixels in (None, some_pixels(150, 170)):
        results = []
        for threads in (1, 2, 5):
            with variant(_environment_map, threads=threads):
                results.append(gradients(partial(look_up_environment_map, camera=camera, pixels=pixels), *parts))
        for other in results[1:]:
            assert all(torch.equal(a, b) for a, b in zip(results[0], other, strict=True))
    pixels = some_pixels(150, 170)
    samples = samples_of(pixels, 3)
    of_samples = []
    for threads in (1, 2, 5):
        with variant(_environment_map, threads=threads):
            shown = sample_gradients(lambda m: look_up_samples(m, samples, camera, pixels), parts[0], parts[2])
        of_samples.append(shown)
    for light, v_maps in of_samples[1:]:
        assert torch.equal(light, of_samples[0][0]) and torch.equal(v_maps, of_samples[0][1])


def test_no_pixels_no_light() -> None:
    parts, nothing = scene(5, 9, 8), torch.zeros(0, dtype=torch.int64)
    came = gradients(lambda m, n: look_up_environment_map(m, n, turned_camera(5, 9), nothing), *parts)
    assert not any(t.any() for t in came)
    samples = torch.zeros(0, 2, 2, 3)
    shown = sample_gradients(lambda m: look_up_samples(m, samples, turned_camera(5, 9), nothing), parts[0], parts[2])
    assert not any(t.any() for t in shown)


@pytest.mark.parametrize("wants", ["maps", "normals"])
def test_one_gradient_alone(wants: str) -> None:
    maps, normals, v_light = scene(20, 30, 8)
    both = gradients(lambda m, n: look_up_environment_map(m, n, turned_camera(20, 30)), maps, normals, v_light)
    leaf = (maps if wants == "maps" else normals).requires_grad_()
    look_up_environment_map(maps, normals, turned_camera(20, 30)).backward(v_light)
    assert leaf.grad is not None
    assert torch.equal(leaf.grad, both[1 if wants == "maps" else 2])


def test_bad_arguments_are_named() -> None:
    maps, normals, _ = scene(5, 9, 8)
    camera = turned_camera(5, 9)
    with pytest.raises(TensorError, match="maps"):
        look_up_environment_map(maps[:, :4], normals, camera)
    with pytest.raises(TensorError, match="maps: expected at least one texel"):
        look_up_environment_map(maps[:, :0, :0], normals, camera)
    with pytest.raises(TensorError, match="normals"):
        look_up_environment_map(maps, normals[:4], camera)
    for pixels in (torch.zeros(3), torch.zeros(3, 1, dtype=torch.int64)):
        with pytest.raises(TensorError, match="pixels"):
            look_up_environment_map(maps, normals, camera, pixels)
    with pytest.raises(ValueError, match="pixels"):
        look_up_environment_map(maps, normals, camera, torch.tensor([0, 45]))


def test_bad_samples_are_named() -> None:
    maps, pixels, camera = scene(5, 9, 8)[0], torch.tensor([3, 4]), turned_camera(5, 9)
    with pytest.raises(TensorError, match="samples"):
        look_up_samples(maps, torch.ones(2, 3, 2, 3), camera, pixels)
    with pytest.raises(TensorError, match="samples: expected at least one"):
        look_up_samples(maps, torch.ones(2, 0, 0, 3), camera, pixels)
    with pytest.raises(TensorError, match="pixels: expected one for each of the 1"):
        look_up_samples(maps, torch.ones(1, 2, 2, 3), camera, pixels)
    with pytest.raises(ValueError, match="pixels"):
        look_up_samples(maps, torch.ones(2, 2, 2, 3), camera, torch.tensor([0, 45]))
