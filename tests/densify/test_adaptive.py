"""Clone, split, prune and reset."""

from __future__ import annotations

import pytest
import torch

from mgsr.config import DensifyConfig
from mgsr.densify.adaptive import adapt, lowered_opacities, rotation_matrices, split_in_two
from mgsr.densify.state import DensifyState

CONFIG = DensifyConfig(gradient_threshold=1.0, split_above=0.1, prune_above=10.0, prune_opacity=0.05)


def splats(count: int, axes: int = 3) -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(1)
    return {
        "means": torch.randn(count, 3, generator=generator),
        "quats": torch.randn(count, 4, generator=generator),
        "log_scales": torch.full((count, axes), -4.0),
        "opacity_logits": torch.zeros(count),
        "sh": torch.randn(count, 4, 3, generator=generator),
    }


def state_of(gradients: list[float]) -> DensifyState:
    return DensifyState(torch.tensor(gradients), torch.ones(len(gradients)))


def seeded() -> torch.Generator:
    return torch.Generator().manual_seed(0)


def test_each_splat_meets_its_fate() -> None:
    parameters = splats(4)
    parameters["log_scales"][2] = 0.0  # large and hot: split
    parameters["opacity_logits"][3] = -5.0  # faint: pruned, however hot
    change = adapt(parameters, state_of([0.0, 2.0, 2.0, 2.0]), CONFIG, 1.0, seeded())
    assert (change.cloned, change.split) == (1, 1)
    assert change.kept.tolist() == [0, 1]
    assert torch.equal(change.added["means"][0], parameters["means"][1])
    assert len(change.added["means"]) == 3
    assert torch.allclose(change.added["log_scales"][1:].exp(), torch.tensor(1 / 1.6))


def test_only_pruning() -> None:
    change = adapt(splats(3), state_of([2.0, 2.0, 2.0]), CONFIG, 1.0, seeded(), grow=False)
    assert change.kept.tolist() == [0, 1, 2]
    assert len(change.added["means"]) == 0


def test_huge_splats_go() -> None:
    parameters = splats(2)
    parameters["log_scales"][1] = 3.0
    assert adapt(parameters, state_of([0.0, 0.0]), CONFIG, 1.0, seeded()).kept.tolist() == [0]


def test_the_cap_keeps_the_steepest() -> None:
    config = DensifyConfig(gradient_threshold=1.0, max_count=5)
    change = adapt(splats(4), state_of([2.0, 5.0, 3.0, 4.0]), config, 100.0, seeded())
    assert change.cloned == 1
    assert torch.equal(change.added["means"][0], splats(4)["means"][1])


def test_a_bright_reflection_keeps_a_faint_splat() -> None:
    parameters = splats(2) | {"refl_opacity_logits": torch.tensor([0.0, -5.0])}
    parameters["opacity_logits"][:] = -5.0
    assert adapt(parameters, state_of([0.0, 0.0]), CONFIG, 1.0, seeded()).kept.tolist() == [0]


@pytest.mark.parametrize("axes", [2, 3])
def test_halves_follow_the_splats_own_shape(axes: int) -> None:
    """Check that drawn centres have the splat's covariance R S S^T R^T, built here by torch's own products."""
    parameters = {name: tensor.expand(20000, *tensor.shape[1:]) for name, tensor in splats(1, axes).items()}
    sizes = torch.tensor([0.5, 0.1, 0.02])[:axes]
    parameters["log_scales"] = sizes.log().expand(20000, axes)
    halves = split_in_two(parameters, 1.6, seeded())
    offsets = halves["means"] - parameters["means"][:1]
    rotation = rotation_matrices(parameters["quats"][:1])[0][:, :axes]
    expected = rotation @ torch.diag(sizes**2) @ rotation.T
    assert torch.allclose(rotation.T @ rotation, torch.eye(axes), atol=1e-5)
    assert torch.allclose(offsets.T @ offsets / len(offsets), expected, atol=5e-3)  # 40,000 draws


def test_gathered_gradients_are_per_half_side() -> None:
    state = DensifyState.empty(2)
    radii = torch.tensor([3.0, 0.0])
    state.gather(torch.tensor([[0.03, 0.04], [0.0, 0.0]]), radii, 100, 100, weight=0.5)
    state.gather(torch.tensor([[0.0, 0.0], [0.0, 0.0]]), radii, 100, 100, weight=0.5)
    assert torch.allclose(state.mean_gradients(), torch.tensor([2.5, 0.0]))


def test_reset_only_lowers() -> None:
    parameters = {"opacity_logits": torch.tensor([-9.0, 9.0]), "refl_opacity_logits": torch.tensor([0.0, 0.0])}
    lowered = lowered_opacities(parameters, 0.01)
    assert torch.allclose(lowered["opacity_logits"].sigmoid(), torch.tensor([1.2339e-4, 0.01]), rtol=1e-3)
    assert float(parameters["opacity_logits"][1]) == 9.0
    assert set(lowered) == {"opacity_logits", "refl_opacity_logits"}
