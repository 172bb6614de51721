"""The CUDA kernels of the render loss, total variation and normals of depth maps, against their oracles."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import torch

from mgsr.ops.depth_normals import depth_to_normals
from mgsr.ops.image_loss import image_loss
from mgsr.ops.tv import edge_aware_tv
from tests.cuda.machines import Machine, on_each_machine, on_each_machine_and_order
from tests.ops import test_depth_normals, test_image_loss, test_tv
from tests.ops.test_image_loss import LOSS, assert_gradients_close, pictures, random_mask
from tests.oracles import depth_normals as normals_oracle
from tests.oracles import image_loss as loss_oracle
from tests.oracles import tv as tv_oracle


def run(
    machine: Machine,
    gradients: Callable[..., tuple[torch.Tensor, ...]],
    function: Callable[..., torch.Tensor],
    *arguments: Any,
    **options: Any,
) -> list[torch.Tensor]:
    """Run a test's `gradients` on a machine, and bring what it returns back to the CPU."""
    moved = [a.to(machine.device) if isinstance(a, torch.Tensor) else a for a in arguments]
    with machine.running():
        return [t.cpu() for t in gradients(function, *moved, **options)]


@on_each_machine_and_order
@pytest.mark.parametrize("size", [(1, 1), (7, 8), (33, 65)])
@pytest.mark.parametrize("masked", [False, True])
def test_loss(machine: Machine, size: tuple[int, int], masked: bool) -> None:
    image, target = pictures(*size)
    mask = random_mask(*size) if masked else None
    came = run(machine, test_image_loss.gradients, image_loss, image, target, 0.8, mask)
    doubles = (image.double(), target.double(), 0.8, None if mask is None else mask.double())
    expected = test_image_loss.gradients(loss_oracle.image_loss, *doubles)
    torch.testing.assert_close(came[0].double(), expected[0], **LOSS)
    assert_gradients_close(came[1], expected[1])
    assert_gradients_close(came[2], expected[2])


@on_each_machine
@pytest.mark.parametrize("wants", ["image", "target"])
def test_one_gradient_alone(machine: Machine, wants: str) -> None:
    image, target = (t.to(machine.device) for t in pictures(20, 35))
    both = run(machine, test_image_loss.gradients, image_loss, image, target)
    leaf = (image if wants == "image" else target).requires_grad_()
    with machine.running():
        image_loss(image, target).backward()
    assert leaf.grad is not None
    assert_gradients_close(leaf.grad.cpu(), both[1 if wants == "image" else 2].double())


@on_each_machine
def test_an_empty_mask_gives_zero(machine: Machine) -> None:
    image, target = pictures(9, 9)
    zeros = torch.zeros(9, 9)
    loss, v_image, _ = run(machine, test_image_loss.gradients, image_loss, image, target, 0.8, zeros)
    assert float(loss) == 0 and not v_image.any()
    values, guide, _ = test_tv.scene(9, 9, None)
    result, v_values = run(machine, test_tv.gradients, edge_aware_tv, values, guide, zeros)
    assert float(result) == 0 and not v_values.any()


@on_each_machine
def test_nan_reaches_the_loss_and_ten_pixels(machine: Machine) -> None:
    image, target = pictures(40, 40)
    image[0, 0, 0] = torch.nan
    loss, v_image, _ = run(machine, test_image_loss.gradients, image_loss, image, target)
    assert torch.isnan(loss) and torch.isnan(v_image[0, 0, 0])
    assert torch.isfinite(v_image[11:]).all() and torch.isfinite(v_image[..., 1:]).all()


@on_each_machine
def test_backward_scales_by_the_incoming_gradient(machine: Machine) -> None:
    image, target = pictures(9, 17)
    once = run(machine, test_image_loss.gradients, image_loss, image, target)[1]
    twice = run(machine, test_image_loss.gradients, lambda a, b: 2.5 * image_loss(a, b), image, target)[1]
    torch.testing.assert_close(twice, 2.5 * once)


@on_each_machine_and_order
@pytest.mark.parametrize("size", [(1, 1), (1, 9), (17, 33)])
@pytest.mark.parametrize("channels", [None, 1, 3])
@pytest.mark.parametrize("masked", [False, True])
def test_total_variation(machine: Machine, size: tuple[int, int], channels: int | None, masked: bool) -> None:
    values, guide, mask = test_tv.scene(*size, channels)
    came = run(machine, test_tv.gradients, edge_aware_tv, values, guide, mask if masked else None)
    doubles = (values.double(), guide.double(), mask.double() if masked else None)
    expected = test_tv.gradients(tv_oracle.edge_aware_tv, *doubles)
    for a, b in zip(came, expected, strict=True):  # four float32 terms a pixel, an exponential good to 2e-7
        assert (a.double() - b).abs().max() <= 2e-6 * b.abs().max()


@on_each_machine_and_order
@pytest.mark.parametrize("size", [(1, 1), (3, 3), (9, 7), (33, 20)])
@pytest.mark.parametrize("with_alpha", [False, True])
def test_normals_of_depth(machine: Machine, size: tuple[int, int], with_alpha: bool) -> None:
    camera, depth = test_depth_normals.turned_camera(*size), test_depth_normals.rough_depth(*size)
    v_normals = torch.randn(*size, 3, generator=torch.Generator().manual_seed(1))
    alpha = torch.rand(*size, generator=torch.Generator().manual_seed(2)) if with_alpha else None
    on_machine = None if alpha is None else alpha.to(machine.device)
    ours = run(
        machine,
        test_depth_normals.gradients,
        lambda d: depth_to_normals(d, camera, on_machine),
        depth,
        v_normals,
    )
    if min(size) < 3:
        assert not any(t.any() for t in ours)
        return
    K, pose = torch.from_numpy(camera.K), torch.from_numpy(camera.cam_from_world)
    scale = 1.0 if alpha is None else alpha.double()[..., None]
    expected = test_depth_normals.gradients(
        lambda d: normals_oracle.depth_to_normals(d, K, pose) * scale, depth.double(), v_normals.double()
    )
    for a, b in zip(ours, expected, strict=True):  # differences of float32 depths: 1e-7 of 2 beside steps of 0.05
        assert (a.double() - b).abs().max() <= 2e-5 * b.abs().max()


@on_each_machine_and_order
def test_the_same_bytes_at_every_run(machine: Machine) -> None:
    image, target = pictures(40, 70)
    reference = machine.ascending()
    for mask in (None, random_mask(40, 70)):
        arguments = (test_image_loss.gradients, image_loss, image, target, 0.8, mask)
        before, after = run(reference, *arguments), run(machine, *arguments)
        assert all(torch.equal(a, b) for a, b in zip(before, after, strict=True))
