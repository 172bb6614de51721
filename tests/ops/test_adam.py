"""Fused Adam against the algorithm in float64, and its rows coming and going."""

from __future__ import annotations

import pytest
import torch

from mgsr.errors import CheckpointError, TensorError
from mgsr.native import _adam
from mgsr.ops.adam import FusedAdam
from tests.ops.variants import ISAS, variant
from tests.oracles import adam as oracle

SHAPES = {"means": (3,), "quats": (4,), "opacity_logits": (), "sh": (16, 3)}
LRS = {"means": 1e-3, "quats": 1e-2, "opacity_logits": 5e-2, "sh": 2.5e-3}
BANDS = torch.cat([torch.ones(1, 3), torch.full((15, 3), 0.05)])


def parameters(n: int) -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(n)
    return {name: torch.randn(n, *shape, generator=generator).requires_grad_() for name, shape in SHAPES.items()}


def gradients(n: int, step: int) -> dict[str, torch.Tensor]:
    """Draw gradients, some as small as 1e-12, which an epsilon of 1e-8 would swallow."""
    generator = torch.Generator().manual_seed(1000 + step)
    scale = {"means": 1e-12, "quats": 1e-3, "opacity_logits": 1.0, "sh": 1e-5}
    return {name: scale[name] * torch.randn(n, *shape, generator=generator) for name, shape in SHAPES.items()}


def run(optimizer: FusedAdam, steps: range) -> None:
    for step in steps:
        n = optimizer.params["means"].shape[0]
        for name, gradient in gradients(n, step).items():
            optimizer.params[name].grad = gradient
        optimizer.step()


@pytest.mark.parametrize("isa", ISAS)
@pytest.mark.parametrize("n", [1, 7, 8, 9, 1111])
def test_matches_the_algorithm(isa: str, n: int) -> None:
    params = parameters(n)
    start = {name: p.detach().double() for name, p in params.items()}
    with variant(_adam, isa):
        run(FusedAdam(params, LRS, lr_scales={"sh": BANDS}), range(6))
    for name, p in params.items():
        lr = LRS[name] * (BANDS.double() if name == "sh" else 1.0)
        expected = oracle.steps(start[name], [gradients(n, step)[name].double() for step in range(6)], lr)
        # Six float32 steps of size lr on values of size 4: rounding of 2.4e-7 each.
        torch.testing.assert_close(p.detach().double(), expected, rtol=0, atol=2e-6)


def test_agrees_with_torch() -> None:
    ours, theirs = parameters(50), parameters(50)
    run(FusedAdam(ours, LRS), range(5))
    reference = torch.optim.Adam([{"params": [p], "lr": LRS[name]} for name, p in theirs.items()], eps=1e-15)
    for step in range(5):
        for name, gradient in gradients(50, step).items():
            theirs[name].grad = gradient
        reference.step()
    for name in ours:
        torch.testing.assert_close(ours[name], theirs[name], rtol=0, atol=2e-6)


def test_same_bytes_for_any_thread_count() -> None:
    results = []
    for threads in (1, 2, 5):
        params = parameters(5001)
        with variant(_adam, threads=threads):
            run(FusedAdam(params, LRS, lr_scales={"sh": BANDS}), range(3))
        results.append(params)
    for other in results[1:]:
        assert all(torch.equal(results[0][name], other[name]) for name in SHAPES)


def test_without_a_gradient_nothing_moves() -> None:
    params = parameters(9)
    before = params["quats"].detach().clone()
    optimizer = FusedAdam(params, LRS)
    params["means"].grad = torch.ones(9, 3)
    optimizer.step()
    assert torch.equal(params["quats"], before)


def test_nan_stays_in_its_place() -> None:
    params = parameters(9)
    optimizer = FusedAdam(params, LRS)
    params["means"].grad = torch.ones(9, 3)
    params["means"].grad[4, 1] = torch.nan
    optimizer.step()
    assert torch.isnan(params["means"]).nonzero().tolist() == [[4, 1]]


@pytest.mark.parametrize("as_index", [False, True])
def test_kept_rows_go_on_as_if_alone(as_index: bool) -> None:
    mask = torch.arange(20) % 3 != 0
    optimizer, alone = FusedAdam(parameters(20), LRS), parameters(20)
    run(optimizer, range(3))
    optimizer.keep(mask.nonzero().squeeze(1) if as_index else mask)
    assert all(p.is_leaf and p.requires_grad and p.grad is None for p in optimizer.params.values())
    reference = FusedAdam(alone, LRS)
    run(reference, range(3))
    later = gradients(20, 7)
    for name, gradient in later.items():
        reference.params[name].grad = gradient
        optimizer.params[name].grad = gradient[mask]
    reference.step()
    optimizer.step()
    for name in SHAPES:
        assert torch.equal(optimizer.params[name], reference.params[name][mask])


def test_new_rows_start_without_momentum() -> None:
    optimizer = FusedAdam(parameters(5), LRS)
    run(optimizer, range(3))
    new = {name: p.detach() for name, p in parameters(2).items()}
    optimizer.extend(new)
    assert all(p.shape[0] == 7 and p.is_leaf and p.requires_grad for p in optimizer.params.values())
    state = optimizer.state_dict()
    assert not any(state[key][name][5:].any() for key in ("first", "second") for name in SHAPES)
    assert all(state["first"][name][:5].any() for name in SHAPES)
    assert torch.equal(optimizer.params["means"][5:], new["means"])


def test_keeping_nothing_and_starting_again() -> None:
    optimizer = FusedAdam(parameters(5), LRS, lr_scales={"sh": BANDS})
    run(optimizer, range(2))
    optimizer.keep(torch.zeros(5, dtype=torch.bool))
    run(optimizer, range(2))
    optimizer.extend({name: p.detach() for name, p in parameters(3).items()})
    run(optimizer, range(2))
    assert all(torch.isfinite(p).all() for p in optimizer.params.values())


def test_replaced_values_forget_their_moments() -> None:
    optimizer = FusedAdam(parameters(5), LRS)
    run(optimizer, range(3))
    optimizer.replace("opacity_logits", torch.full((5,), -2.0))
    assert torch.equal(optimizer.params["opacity_logits"], torch.full((5,), -2.0))
    assert not optimizer.state_dict()["first"]["opacity_logits"].any()
    assert optimizer.state_dict()["first"]["means"].any()


def test_a_restored_state_gives_the_same_bytes() -> None:
    through = FusedAdam(parameters(20), LRS)
    run(through, range(3))
    saved = {name: p.detach().clone() for name, p in through.params.items()}
    state = {key: {n: v.clone() if isinstance(v, torch.Tensor) else v for n, v in part.items()}
             for key, part in through.state_dict().items()}  # fmt: skip
    run(through, range(3, 6))
    resumed = FusedAdam(saved, LRS)
    resumed.load_state_dict(state)
    run(resumed, range(3, 6))
    assert all(torch.equal(through.params[name], resumed.params[name]) for name in SHAPES)


def test_learning_rates_change() -> None:
    optimizer = FusedAdam(parameters(5), LRS)
    optimizer.set_lrs(dict.fromkeys([*SHAPES, "a parameter that it has not"], 0.0))
    before = {name: p.detach().clone() for name, p in optimizer.params.items()}
    run(optimizer, range(2))
    assert all(torch.equal(optimizer.params[name], before[name]) for name in SHAPES)


def test_bad_arguments_are_named() -> None:
    optimizer = FusedAdam(parameters(5), LRS)
    with pytest.raises(TensorError, match="set_lrs: expected a rate for each of"):
        optimizer.set_lrs({"colour": 1.0})
    with pytest.raises(TensorError, match="rows"):
        optimizer.extend({"means": torch.zeros(1, 3)})
    with pytest.raises(TensorError, match="lrs"):
        FusedAdam(parameters(5), {"means": 1.0})
    with pytest.raises(CheckpointError, match="moments"):
        optimizer.load_state_dict(FusedAdam(parameters(6), LRS).state_dict())
