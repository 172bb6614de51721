"""Reflected light and a flash on images, against torch's own gradients in float64, on every kernel."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from mgsr.native import _lights
from mgsr.native.cuda.launcher import launcher_for
from mgsr.ops.lights import OFFSET, apply_shading, apply_shading_vjp, with_reflection, with_reflection_vjp
from tests.cuda.machines import Machine, on_every_kernel
from tests.ops.variants import ISAS, variant


def random(*shapes: tuple[int, ...], seed: int = 0) -> list[Tensor]:
    generator = torch.Generator().manual_seed(seed)
    return [torch.rand(shape, generator=generator) for shape in shapes]


def assert_close(ours: Tensor, theirs: Tensor | None) -> None:
    assert theirs is not None and torch.allclose(ours.cpu().double(), theirs, atol=1e-6)


@on_every_kernel
@pytest.mark.parametrize("added", [False, True])
@pytest.mark.parametrize("lights", [("own",), ("environment_map",), ("own", "environment_map")], ids="+".join)
def test_reflected_light_is_added(machine: Machine, lights: tuple[str, ...], added: bool) -> None:
    """Check that reflected light is added; `added`: as where the loss looks at the parts too."""
    inputs = random((5, 7, 3), (5, 7), *((5, 7, 3) for _ in lights))
    v_color, *v_parts = random((5, 7, 3), (5, 7, 3), (5, 7), (5, 7, 3), seed=1)
    on_machine = [each.to(machine.device) for each in inputs]
    named = dict(zip(lights, on_machine[2:], strict=True))
    v_reflected, v_weight, v_light = (each.to(machine.device) if added else None for each in v_parts)
    before = (v_reflected, v_weight, v_light)
    with machine.running():
        launcher = launcher_for(on_machine[0])
        arrays = (on_machine[0], on_machine[1], named.get("own"), named.get("environment_map"))
        color, reflected = with_reflection(launcher, *arrays)
        gradients = with_reflection_vjp(launcher, v_color.to(machine.device), reflected, on_machine[1], before)
    transmitted, weight, *parts = [each.double().requires_grad_() for each in inputs]
    light = torch.stack(parts).sum(0)
    expected = transmitted + weight[..., None] * light
    assert_close(color, expected.detach())
    assert_close(reflected, light.detach())
    looked_at = dict(zip(lights, parts, strict=True)).get("own")
    loss = (expected * v_color).sum()
    if added:
        loss = loss + (transmitted * v_parts[0]).sum() + (weight * v_parts[1]).sum()
        loss = loss if looked_at is None else loss + (looked_at * v_parts[2]).sum()
    loss.backward()
    for ours, theirs in zip(gradients, (transmitted, weight), strict=False):
        assert_close(ours, theirs.grad)
    for name, theirs in zip(lights, parts, strict=True):
        assert_close(gradients[2 if name == "own" else 3], theirs.grad)


@on_every_kernel
@pytest.mark.parametrize("added", [False, True])
def test_a_flash_lights_the_object_alone(machine: Machine, added: bool) -> None:
    inputs = random((5, 7, 3), (5, 7), (3,), (5, 7))
    v_image, v_alpha = random((5, 7, 3), (5, 7), seed=1)
    even, alpha, background, lit = (each.to(machine.device) for each in inputs)
    with machine.running():
        launcher = launcher_for(even)
        image = apply_shading(launcher, even, alpha, background, lit)
        before = v_alpha.to(machine.device) if added else None
        gradients = apply_shading_vjp(launcher, v_image.to(machine.device), background, lit, before)
    exact = [each.double().requires_grad_() for each in inputs]
    # sRGB is linear in light^(1/2.4) but for an offset, and what lies behind is not lit.
    behind = (1 - exact[1])[..., None] * exact[2]
    own = exact[0] - behind + exact[1][..., None] * OFFSET
    expected = own * exact[3][..., None] - exact[1][..., None] * OFFSET + behind
    ((expected * v_image).sum() + (exact[1] * v_alpha).sum() * added).backward()
    assert_close(image, expected.detach())
    assert_close(gradients[0], exact[0].grad)
    assert_close(gradients[1], exact[1].grad)


def to_srgb(light: np.ndarray) -> np.ndarray:
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 1e-9) ** (1 / 2.4) - 0.055)


def test_paint_times_light_in_linear_light() -> None:
    """Check that the image is paint times light in linear light.

    This holds for an object that half covers its pixels, too: what lies behind is not lit.
    """
    generator = np.random.default_rng(0)
    paint, light = generator.uniform(0.05, 1, (6, 8, 3)), generator.uniform(0.1, 1, (6, 8))
    alpha, behind = generator.choice([0, 0.5, 1], (6, 8)), np.array([0.2, 0.5, 0.9])
    on = (1 - alpha[..., None]) * behind
    even = alpha[..., None] * to_srgb(paint) + on
    expected = alpha[..., None] * to_srgb(paint * light[..., None]) + on
    got = apply_shading(None, *(torch.from_numpy(each).float() for each in (even, alpha, behind, light ** (1 / 2.4))))
    # The curve's straight part near black, which the formula leaves out, is a thousandth off at most here.
    assert np.abs(got.numpy() - expected).max() < 2e-3
    bright = paint.min(axis=-1) * light > 0.0032
    assert np.abs(got.numpy() - expected)[bright].max() < 1e-6


@pytest.mark.parametrize("isa", ISAS)
def test_large_images_on_every_variant(isa: str) -> None:
    """Check images of several tasks, whose size is no multiple of a vector."""
    size = 41, 37
    color, own, light, weight, alpha = random((*size, 3), (*size, 3), (*size, 3), size, size)
    behind, lit = torch.tensor([0.2, 0.5, 0.9]), 0.2 + 0.8 * weight
    with variant(_lights, isa):
        reflecting, reflected = with_reflection(None, color, weight, own, light)
        v_parts = with_reflection_vjp(None, color, reflected, weight, (None, None, None))
        image = apply_shading(None, color, alpha, behind, lit)
        v_unlit, v_alpha = apply_shading_vjp(None, color, behind, lit, None)
    share = weight.double()[..., None]
    assert_close(reflecting, color + share * (own.double() + light))
    for ours, theirs in zip(v_parts, (color, (color * reflected).sum(-1), color * share, color * share), strict=True):
        assert_close(ours, theirs.double())
    lost = lit.double()[..., None] - 1
    assert_close(image, color + lost * (color + alpha[..., None] * (behind + OFFSET) - behind))
    assert_close(v_unlit, color * lit.double()[..., None])
    assert_close(v_alpha, (lost * color * (behind + OFFSET)).sum(-1))


def test_full_light_changes_nothing() -> None:
    even, alpha = torch.rand(3, 4, 3), torch.rand(3, 4)
    assert torch.equal(apply_shading(None, even, alpha, torch.rand(3), torch.ones(3, 4)), even)
