"""Both branches rendered from what is stored, in one node, against float64 oracles put together by torch."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from mgsr.errors import TensorError
from mgsr.gaussians.gaussians import GaussianModel
from mgsr.gaussians.surfels import SurfelModel
from mgsr.ops.lights import OFFSET
from mgsr.renderers.gaussians import render_gaussians
from mgsr.renderers.surfels import render_surfels
from tests.cuda.machines import Machine, on_every_kernel
from tests.ops.splat_scenes import camera, random_splats
from tests.optional import present
from tests.oracles import gaussians as gaussian_oracle
from tests.oracles import harmonics as harmonics_oracle
from tests.oracles import surfels as surfel_oracle

COUNT, LOW_PASS = 40, 0.3
VIEW = camera()
BEHIND = torch.tensor([0.2, 0.5, 0.9])
# float32 rounding through tens of layers, as for the rasters alone.
IMAGES, GRADIENTS = 2e-5, 3e-4


def draw(*shape: int, seed: int = 0) -> Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def stored(scale_dims: int, split: bool) -> dict[str, Tensor]:
    """Draw float64 parameters as a model stores them."""
    splats = random_splats(COUNT, scale_dims)
    parameters = {
        "means": splats["means"],
        "quats": splats["quats"],
        "log_scales": splats["scales"].log(),
        "opacity_logits": splats["opacities"].logit(),
        "sh": draw(COUNT, 9, 3, seed=1) - 0.3,
    }
    if split:
        parameters |= {
            "refl_opacity_logits": 3 * draw(COUNT, seed=2),
            "weight_logits": 3 * draw(COUNT, seed=3) - 2,
            "refl_sh": draw(COUNT, 4, 3, seed=4),
        }
    return parameters


def colors(leaves: dict[str, Tensor], name: str, degree: int) -> Tensor:
    center = torch.from_numpy(VIEW.center.copy())
    return harmonics_oracle.harmonics_to_rgb(leaves[name], leaves["means"], center, degree)


def flashed(even: Tensor, alpha: Tensor, lit: Tensor | None) -> Tensor:
    if lit is None:
        return even
    behind = (1 - alpha)[..., None] * BEHIND.double()
    own = even - behind + alpha[..., None] * OFFSET
    return own * lit[..., None] - alpha[..., None] * OFFSET + behind


def compare(
    machine: Machine,
    render: Callable[..., dict[str, Tensor]],
    oracle: Callable[..., dict[str, Tensor]],
    parameters: dict[str, Tensor],
    extra: dict[str, Tensor],
) -> None:
    """Compare images, and every gradient of a fixed random combination of them, with the oracle's.

    extra: what else is drawn from, as `render` and `oracle` take it, with gradients.
    """
    mine = {name: tensor.float().to(machine.device).requires_grad_() for name, tensor in parameters.items()}
    theirs = {name: tensor.clone().requires_grad_() for name, tensor in parameters.items()}
    own, exact = (
        {name: tensor.to(device, dtype).requires_grad_() for name, tensor in extra.items()}
        for device, dtype in ((machine.device, torch.float32), (torch.device("cpu"), torch.float64))
    )
    with machine.running():
        came = render(mine, **own)
        weights = {name: draw(*image.shape, seed=9 + len(name)) - 0.5 for name, image in came.items()}
        torch.stack([(image * weights[name].to(image)).sum() for name, image in came.items()]).sum().backward()
    expected = oracle(theirs, **exact)
    torch.stack([(image * weights[name]).sum() for name, image in expected.items()]).sum().backward()
    for name, image in expected.items():
        error = (came[name].detach().cpu().double() - image.detach()).abs().max()
        assert error < IMAGES * max(1.0, float(image.detach().abs().max())), f"{name}: off by {error:.2e}"
    for name, leaf in (theirs | exact).items():
        got = (mine | own)[name].grad
        assert got is not None and leaf.grad is not None, name
        error = (got.cpu().double() - leaf.grad).abs().max() / leaf.grad.abs().max().clamp(min=1.0)
        assert error < GRADIENTS, f"{name}: gradient off by {error:.2e}"


@on_every_kernel
@pytest.mark.parametrize("flash", [False, True])
@pytest.mark.parametrize("lights", [(), ("own",), ("environment_map",), ("own", "environment_map")], ids="+".join)
def test_gaussians(machine: Machine, lights: tuple[str, ...], flash: bool) -> None:
    lit = draw(VIEW.height, VIEW.width, seed=5) if flash else None
    extra = {"environment": draw(VIEW.height, VIEW.width, 3, seed=6)} if "environment_map" in lights else {}

    def render(leaves: dict[str, Tensor], environment: Tensor | None = None) -> dict[str, Tensor]:
        model = GaussianModel(**leaves, low_pass=LOW_PASS)
        on_machine = None if lit is None else lit.float().to(machine.device)
        out = render_gaussians(
            model, VIEW, BEHIND.to(machine.device), 2, 1, environment=environment, shading=on_machine
        )
        shown = {"color": out.color, "alpha": out.alpha, "depth": present(out.depth)}
        if lights:
            shown |= {"transmitted": out.transmitted, "weight": present(out.weight)}
        return shown | ({"own": present(out.own_reflected)} if "own" in lights else {})

    def oracle(leaves: dict[str, Tensor], environment: Tensor | None = None) -> dict[str, Tensor]:
        split = None
        if "own" in lights:
            shares = leaves["refl_opacity_logits"].sigmoid(), leaves["weight_logits"].sigmoid()
            split = (shares[0], colors(leaves, "refl_sh", 1), shares[1])
        geometry = (leaves["means"], leaves["quats"], leaves["log_scales"].exp(), leaves["opacity_logits"].sigmoid())
        out = gaussian_oracle.render(
            *geometry, colors(leaves, "sh", 2), VIEW, BEHIND.double(), split, low_pass=LOW_PASS
        )
        transmitted = flashed(out.color, out.alpha, lit)
        shown = {"color": transmitted, "alpha": out.alpha, "depth": out.depth}
        if lights:
            weight = out.weight if "own" in lights else out.alpha
            parts = [each for each in (out.reflected if "own" in lights else None, environment) if each is not None]
            assert weight is not None
            shown["color"] = transmitted + weight[..., None] * sum(parts)
            shown |= {"transmitted": transmitted, "weight": weight}
        return shown | ({"own": present(out.reflected)} if "own" in lights else {})

    compare(machine, render, oracle, stored(3, split="own" in lights), extra)


@on_every_kernel
@pytest.mark.parametrize("flash", [False, True])
def test_surfels(machine: Machine, flash: bool) -> None:
    lit = draw(VIEW.height, VIEW.width, seed=5) if flash else None

    def render(leaves: dict[str, Tensor]) -> dict[str, Tensor]:
        on_machine = None if lit is None else lit.float().to(machine.device)
        out = render_surfels(SurfelModel(**leaves), VIEW, BEHIND.to(machine.device), 2, shading=on_machine)
        return {"color": out.color, "alpha": out.alpha, "depth": out.depth, "normal": out.normal}

    def oracle(leaves: dict[str, Tensor]) -> dict[str, Tensor]:
        geometry = (leaves["means"], leaves["quats"], leaves["log_scales"].exp(), leaves["opacity_logits"].sigmoid())
        K, pose = torch.from_numpy(VIEW.K), torch.from_numpy(VIEW.cam_from_world)
        out = surfel_oracle.render(
            *geometry, colors(leaves, "sh", 2), K, pose, VIEW.width, VIEW.height, BEHIND.double()
        )
        color = flashed(out.color, out.alpha, lit)
        return {"color": color, "alpha": out.alpha, "depth": out.depth, "normal": out.normal}

    compare(machine, render, oracle, stored(2, split=False), {})


@on_every_kernel
def test_what_the_loss_does_not_look_at_costs_nothing(machine: Machine) -> None:
    """Check that a loss on the transmitted image sends no gradient to the reflected half or the environment."""
    leaves = {name: each.float().to(machine.device).requires_grad_() for name, each in stored(3, split=True).items()}
    environment = draw(VIEW.height, VIEW.width, 3).float().to(machine.device).requires_grad_()
    with machine.running():
        out = render_gaussians(GaussianModel(**leaves, low_pass=LOW_PASS), VIEW, environment=environment)
        out.transmitted.sum().backward()
    assert leaves["sh"].grad is not None
    assert leaves["refl_sh"].grad is not None and leaves["weight_logits"].grad is not None
    assert leaves["sh"].grad.any() and not leaves["refl_sh"].grad.any() and not leaves["weight_logits"].grad.any()
    assert environment.grad is None or not environment.grad.any()


def test_a_model_that_does_not_fit_together_is_named() -> None:
    parameters = {name: tensor.float() for name, tensor in stored(3, split=True).items()}
    parameters["weight_logits"] = parameters["weight_logits"][:-1]
    with pytest.raises(TensorError, match=r"weight_logits: expected \[N=40\], got \[39\]"):
        render_gaussians(GaussianModel(**parameters, low_pass=LOW_PASS), VIEW)
    parameters = {name: tensor.float() for name, tensor in stored(2, split=False).items()}
    with pytest.raises(TensorError, match=r"degree: expected 0\.\.2 for K = 9, got 3"):
        render_surfels(SurfelModel(**parameters), VIEW, degree=3)
