"""The environment map's CUDA kernels against torch's own operations in float64."""

from __future__ import annotations

import pytest
import torch

from mgsr.ops.environment_map import look_up_environment_map, look_up_samples
from tests.cuda.machines import Machine, on_each_machine, on_each_machine_and_order
from tests.ops.test_depth_normals import turned_camera
from tests.ops.test_environment_map import (
    Scene,
    assert_close,
    expected_of,
    expected_of_samples,
    gradients,
    sample_gradients,
    samples_of,
    scene,
    some_pixels,
)


def run(
    machine: Machine, parts: Scene, size: tuple[int, int], pixels: torch.Tensor | None = None
) -> list[torch.Tensor]:
    """Return the light and gradients of a machine, on the CPU."""
    there = None if pixels is None else pixels.to(machine.device)
    with machine.running():
        came = gradients(
            lambda m, n: look_up_environment_map(m, n, turned_camera(*size), there),
            *(t.to(machine.device) for t in parts),
        )
    return [t.cpu() for t in came]


@on_each_machine_and_order
@pytest.mark.parametrize("size", [(1, 1), (9, 8), (33, 20)])
@pytest.mark.parametrize("side", [1, 2, 9])
@pytest.mark.parametrize("chosen", [False, True])
def test_matches_the_oracle(machine: Machine, size: tuple[int, int], side: int, chosen: bool) -> None:
    parts, pixels = scene(*size, side), some_pixels(*size) if chosen else None
    assert_close(run(machine, parts, size, pixels), expected_of(parts, turned_camera(*size), pixels))


def run_samples(machine: Machine, parts: Scene, size: tuple[int, int], rows: int) -> list[torch.Tensor]:
    """Return the light and the maps' gradient of samples in some pixels, on the CPU."""
    pixels = some_pixels(*size)
    samples, there = (t.to(machine.device) for t in (samples_of(pixels, rows), pixels))
    maps, _, v_light = (t.to(machine.device) for t in parts)
    with machine.running():
        came = sample_gradients(lambda m: look_up_samples(m, samples, turned_camera(*size), there), maps, v_light)
    return [t.cpu() for t in came]


@on_each_machine_and_order
@pytest.mark.parametrize("size", [(1, 1), (33, 20)])
@pytest.mark.parametrize("side", [1, 9])
@pytest.mark.parametrize("rows", [1, 3])
def test_samples_match_the_oracle(machine: Machine, size: tuple[int, int], side: int, rows: int) -> None:
    parts, pixels = scene(*size, side), some_pixels(*size)
    expected = expected_of_samples(parts, samples_of(pixels, rows), turned_camera(*size), pixels)
    assert_close(run_samples(machine, parts, size, rows), expected)


@on_each_machine
def test_normals_without_length(machine: Machine) -> None:
    maps, normals, v_light = scene(9, 12, 8)
    normals[::2] = 0
    came = run(machine, (maps, normals, v_light), (9, 12))
    assert_close(came, expected_of((maps, normals, v_light), turned_camera(9, 12)))
    assert not came[2][::2].any()


@on_each_machine
def test_no_pixels_no_light(machine: Machine) -> None:
    came = run(machine, scene(5, 9, 8), (5, 9), torch.zeros(0, dtype=torch.int64))
    assert not any(t.any() for t in came)


@on_each_machine
@pytest.mark.parametrize("wants", ["maps", "normals"])
def test_one_gradient_alone(machine: Machine, wants: str) -> None:
    parts = scene(20, 30, 8)
    both = run(machine, parts, (20, 30))
    maps, normals, v_light = (t.to(machine.device) for t in parts)
    leaf = (maps if wants == "maps" else normals).requires_grad_()
    with machine.running():
        look_up_environment_map(maps, normals, turned_camera(20, 30)).backward(v_light)
    assert leaf.grad is not None
    assert torch.equal(leaf.grad.cpu(), both[1 if wants == "maps" else 2])


@on_each_machine_and_order
def test_the_same_bytes_at_every_run(machine: Machine) -> None:
    """Check that the bytes are the same at every run and in every order of threads and blocks.

    A difference would be a race. A cell has many pixels.
    """
    parts = scene(40, 50, 3)
    reference = machine.ascending()
    before, after = run(reference, parts, (40, 50)), run(machine, parts, (40, 50))
    assert all(torch.equal(a, b) for a, b in zip(before, after, strict=True))
    before, after = run_samples(reference, parts, (40, 50), 2), run_samples(machine, parts, (40, 50), 2)
    assert all(torch.equal(a, b) for a, b in zip(before, after, strict=True))
