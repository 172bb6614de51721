"""Edge-aware total variation against the oracle."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch

from mgsr.errors import TensorError
from mgsr.native import _image
from mgsr.ops.tv import edge_aware_tv
from tests.ops.variants import ISAS, variant
from tests.oracles import tv as oracle


def gradients(
    function: Callable[..., torch.Tensor], values: torch.Tensor, guide: torch.Tensor, mask: torch.Tensor | None = None
) -> tuple[torch.Tensor, torch.Tensor]:
    values = values.clone().requires_grad_()
    result = function(values, guide, mask)
    if result.requires_grad:
        result.backward()
    return result.detach(), torch.zeros_like(values) if values.grad is None else values.grad


def scene(height: int, width: int, channels: int | None) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(height * 1000 + width)
    shape = (height, width) if channels is None else (height, width, channels)
    values, guide = torch.randn(shape, generator=generator), torch.rand(height, width, 3, generator=generator)
    return values, guide, (torch.rand(height, width, generator=generator) > 0.3).float()


@pytest.mark.parametrize("isa", ISAS)
@pytest.mark.parametrize("size", [(1, 1), (1, 7), (8, 1), (7, 9), (33, 65), (70, 40)])
@pytest.mark.parametrize("channels", [None, 1, 3, 5])
@pytest.mark.parametrize("masked", [False, True])
def test_matches_the_oracle(isa: str, size: tuple[int, int], channels: int | None, masked: bool) -> None:
    values, guide, mask = scene(*size, channels)
    with variant(_image, isa):
        came = gradients(edge_aware_tv, values, guide, mask if masked else None)
    expected = gradients(oracle.edge_aware_tv, values.double(), guide.double(), mask.double() if masked else None)
    for a, b in zip(came, expected, strict=True):  # four float32 terms a pixel, an exponential good to 2e-7
        assert (a.double() - b).abs().max() <= 2e-6 * b.abs().max()


def test_constant_values_cost_nothing() -> None:
    _, guide, _ = scene(9, 9, 3)
    result, v_values = gradients(edge_aware_tv, torch.full((9, 9, 3), 0.7), guide)
    assert float(result) == 0
    assert not v_values.any()


def test_an_edge_of_the_guide_costs_less() -> None:
    step = torch.zeros(4, 8)
    step[:, 4:] = 1
    flat, edge = torch.zeros(4, 8, 3), step[..., None].expand(4, 8, 3).contiguous()
    ratio = edge_aware_tv(step, edge) / edge_aware_tv(step, flat)
    torch.testing.assert_close(ratio, torch.exp(torch.tensor(-1.0)))


def test_an_empty_mask_gives_zero() -> None:
    values, guide, _ = scene(9, 9, None)
    result, v_values = gradients(edge_aware_tv, values, guide, torch.zeros(9, 9))
    assert float(result) == 0
    assert not v_values.any()


def test_same_bytes_for_any_thread_count() -> None:
    values, guide, mask = scene(200, 123, 3)
    results = []
    for threads in (1, 2, 5):
        with variant(_image, threads=threads):
            results.append(gradients(edge_aware_tv, values, guide, mask))
    for other in results[1:]:
        assert all(torch.equal(a, b) for a, b in zip(results[0], other, strict=True))


def test_nan_reaches_the_result_and_the_neighbours_only() -> None:
    values, guide, _ = scene(9, 9, None)
    values[4, 4] = torch.nan
    result, v_values = gradients(edge_aware_tv, values, guide)
    assert torch.isnan(result)
    assert torch.isnan(v_values).sum() == 5


def test_the_guide_gets_no_gradient() -> None:
    values, guide, _ = scene(9, 9, None)
    guide.requires_grad_()
    edge_aware_tv(values.requires_grad_(), guide).backward()
    assert guide.grad is None


def test_bad_arguments_are_named() -> None:
    values, guide, mask = scene(9, 9, None)
    with pytest.raises(TensorError, match="guide"):
        edge_aware_tv(values, guide[..., :2])
    with pytest.raises(TensorError, match="mask"):
        edge_aware_tv(values, guide, mask[:8])
