"""Schedules, view order, targets and convergence tests."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch

from mgsr.config import PaperConfig, RatesConfig, StopRule, TrainConfig, WarmupConfig, make_config
from mgsr.data.backdrop import WHITE, Backdrop
from mgsr.training.convergence import EpochMeans, LossRange, Validation, make_convergence
from mgsr.training.plan import make_plan
from mgsr.training.schedule import rates_at, rest_scale, sh_degree_at
from mgsr.training.stages import Step, gaussians_alone, surfels_alone
from mgsr.training.train_state import TrainState
from mgsr.training.views import TrainingView, ViewCycle, bounding_box, pick_background, prepare_views
from tests.optional import present
from tests.training.ball import ball_points, ball_scene


def test_rates_fade_from_start_to_end() -> None:
    config = RatesConfig(position=1.6e-4, position_end=1.6e-6, decay_from=0.5, final_factor=0.1)
    assert rates_at(0.0, config, 2.0)["means"] == pytest.approx(2 * config.position)
    assert rates_at(1.0, config, 2.0)["means"] == pytest.approx(2 * config.position_end)
    assert rates_at(0.5, config, 1.0)["means"] == pytest.approx(1.6e-5)
    assert rates_at(0.5, config, 1.0)["log_scales"] == config.scale
    assert rates_at(0.75, config, 1.0)["log_scales"] == pytest.approx(0.1**0.5 * config.scale)
    assert rates_at(1.0, config, 1.0)["log_scales"] == pytest.approx(0.1 * config.scale)


def test_higher_bands_learn_slower() -> None:
    scale = rest_scale(torch.zeros(5, 4, 3), RatesConfig(sh=2e-3, sh_rest=1e-4))
    assert scale[0].tolist() == [1, 1, 1]
    assert torch.allclose(scale[1:], torch.tensor(1 / 20))


def test_sh_degree_rises_in_steps() -> None:
    degrees = [sh_degree_at(i, 100, 0.1, 3) for i in (0, 9, 10, 20, 30, 99)]
    assert degrees == [0, 0, 1, 2, 3, 3]
    assert sh_degree_at(0, 100, 0.0, 3) == 3


def test_each_view_comes_once_an_epoch() -> None:
    cycle = ViewCycle(5, torch.Generator().manual_seed(0))
    epochs = []
    for _ in range(4):
        epochs.append([cycle.next() for _ in range(5)])
        assert cycle.at_epoch_end
    assert all(sorted(epoch) == list(range(5)) for epoch in epochs)
    assert len({tuple(epoch) for epoch in epochs}) > 1


@pytest.mark.parametrize("margin", [None, 1])
def test_targets_are_composited(margin: int | None) -> None:
    view = ball_scene().train[0]
    (prepared,) = prepare_views([view], masked=True, margin=margin)
    target = prepared.target(torch.tensor([0.2, 0.4, 0.6]))
    assert view.alpha is not None
    alpha = view.alpha[..., None] / 255.0
    expected = view.image / 255.0 * alpha + (1 - alpha) * [0.2, 0.4, 0.6]
    box = (slice(None), slice(None)) if margin is None else present(bounding_box(view.alpha, margin))
    assert np.allclose(target.color.numpy(), expected[box], atol=1e-6)


def test_a_part_keeps_its_rays_and_regions() -> None:
    view = ball_scene().train[0]
    (whole,) = prepare_views([view], masked=True, edge_band=2)
    (part,) = prepare_views([view], masked=True, margin=3, edge_band=2)
    rows, columns = present(bounding_box(present(view.alpha), 3))
    assert part.whole == whole.whole == (48, 48)
    assert part.share == (rows.stop - rows.start) * (columns.stop - columns.start) / 48**2 < 0.7
    corner = np.array([[0.3, 0.2, 0.1]])
    shifted = view.camera.project(corner)[0] - [columns.start, rows.start]
    assert np.allclose(part.camera.project(corner)[0], shifted)
    assert torch.equal(present(part.off_edge), present(whole.off_edge)[rows, columns])
    alpha = present(view.alpha)[rows, columns]
    assert np.array_equal(present(part.covered).numpy(), np.flatnonzero(alpha))


@pytest.mark.parametrize("branch", ["surfels", "gaussians"])
def test_a_part_costs_what_its_photograph_costs(branch: str) -> None:
    """Check that loss and gradients of the part around the object are those of the whole photograph."""
    config, scene = make_config("draft", "mgsr", 0), ball_scene(64)
    wide, tight = (prepare_views(scene.train[:1], masked=True, margin=margin, edge_band=2)[0] for margin in (None, 10))
    assert tight.share < 0.95

    def step(view: TrainingView) -> tuple[float, dict[str, torch.Tensor], torch.Tensor]:
        state = make_plan(scene, ball_points(3000), config).train_state
        found: Step = _compute(branch, state, config.train)(view, (0.0, 0.0, 0.0), 0)
        found.loss.backward()
        model = present(getattr(state, branch)).model
        gradients = {name: value.grad for name, value in model.parameters().items() if value.grad is not None}
        return found.loss.value.item(), gradients, found.renders[0].stats.v_means2d

    loss, gradients, screen = step(wide)
    part_loss, part_gradients, part_screen = step(tight)
    assert part_loss == pytest.approx(loss, rel=1e-5)
    assert gradients.keys() == part_gradients.keys() and "means" in gradients
    for name, gradient in gradients.items():
        assert (part_gradients[name] - gradient).abs().max() <= 1e-3 * gradient.abs().max() + 1e-9, name
    assert (part_screen - screen).abs().max() <= 1e-3 * screen.abs().max()


def _compute(branch: str, state: TrainState, train: TrainConfig) -> Callable[..., Step]:
    if branch == "surfels":
        return surfels_alone(present(state.surfels), train, warming=False)
    return gaussians_alone(present(state.gaussians), train, warming=False)


def test_photographs_are_not_copied() -> None:
    view = ball_scene().train[0]
    (prepared,) = prepare_views([view], masked=True, margin=2, edge_band=1)
    assert np.shares_memory(prepared.image.numpy(), view.image)
    assert prepared.mask is not None
    assert np.shares_memory(prepared.mask.numpy(), view.alpha)


def test_small_views_average_light_and_alpha() -> None:
    view = ball_scene(48).train[0]
    (small,) = prepare_views([view], masked=True, reduce=2)
    assert view.alpha is not None
    alpha = view.alpha[..., None] / 255.0
    blocks = np.concatenate([view.image / 255.0 * alpha, alpha], axis=-1).reshape(24, 2, 24, 2, 4).mean(axis=(1, 3))
    target, half = small.target(torch.zeros(3)), 0.51 / 255  # they are bytes again
    assert np.allclose(target.color.numpy(), blocks[..., :3], atol=2 * half)
    assert target.alpha is not None
    assert np.allclose(target.alpha.numpy(), blocks[..., 3], atol=half)
    assert small.covered is not None
    assert np.array_equal(small.covered.numpy(), np.flatnonzero(blocks[..., 3] > 0.5 / 255))
    corner = np.array([0.3, 0.2, 0.1])
    assert np.allclose(small.camera.project(corner[None])[0], view.camera.project(corner[None])[0] / 2)


def test_the_flashs_light_goes_with_its_view() -> None:
    lit = np.random.default_rng(0).integers(0, 256, (48, 48)).astype(np.uint8)
    view = replace(ball_scene(48).train[0], irradiance=lit)
    (whole,), (small,) = prepare_views([view], masked=True), prepare_views([view], masked=True, reduce=2)
    assert np.allclose(present(whole.shading()).numpy(), lit / 255, atol=1e-6)
    mean = lit.reshape(24, 2, 24, 2).mean(axis=(1, 3)) / 255
    assert np.allclose(present(small.shading()).numpy(), mean, atol=0.51 / 255)
    assert prepare_views([replace(view, irradiance=None)], masked=True)[0].shading() is None


def test_small_views_of_odd_sides() -> None:
    (small,) = prepare_views([ball_scene(47).train[0]], masked=True, reduce=2)
    assert small.image.shape == (24, 24, 3) and (small.camera.width, small.camera.height) == (24, 24)


def test_warm_ups_begin_with_small_views_if_photographs_are_large() -> None:
    settings = ["surfel_iterations=10", "gaussian_iterations=20", "coarse=0.4", "environment_map.iterations=0"]
    config = make_config("draft", "mgsr", 0, [*settings, "coarse_side=48"])
    stages = make_plan(ball_scene(48), ball_points(), config).stages
    widths = []
    for stage in stages:
        stage.iteration = 0
        widths.append([stage.next_view().camera.width])
        for stage.iteration in (3, 4, 7, 8):
            widths[-1].append(stage.next_view().camera.width)
    assert widths == [[24, 24, 48, 48, 48], [24, 24, 24, 24, 48], [48, 48, 48, 48, 48]]
    (stage, *_) = make_plan(ball_scene(47), ball_points(), config).stages
    assert stage.next_view().camera.width == 47


def test_a_box_bounds_the_mask() -> None:
    alpha = np.zeros((20, 30), dtype=np.uint8)
    alpha[5:8, 10:25] = 1
    assert bounding_box(alpha, 2) == (slice(3, 10), slice(8, 27))
    assert bounding_box(alpha, 100) == (slice(0, 20), slice(0, 30))
    assert bounding_box(0 * alpha, 2) is None


def test_backgrounds() -> None:
    generator = torch.Generator().manual_seed(0)
    assert pick_background(Backdrop((0.1, 0.2, 0.3)), generator) == (0.1, 0.2, 0.3)
    first, second = (pick_background(Backdrop(WHITE, random=True), generator) for _ in range(2))
    assert first != second


def feed(test: EpochMeans | LossRange, losses: list[float], epoch: int = 4) -> int | None:
    """Return the iteration at which a test stops, if any."""
    for i, loss in enumerate(losses, start=1):
        if test.converged(torch.tensor(loss), i, i % epoch == 0):
            return i
    return None


def test_epoch_means_ignore_the_difference_of_views() -> None:
    """Check that losses that differ between views but not between epochs have converged.

    The paper's range sees only noise.
    """
    views = [0.1, 0.5, 0.2, 0.9]
    assert feed(EpochMeans(0, 2, 0.01), views * 30) == 16
    assert feed(LossRange(0, 0.01), views * 30) is None
    falling = [loss * 0.9**epoch for epoch in range(30) for loss in views]
    assert feed(EpochMeans(0, 2, 0.01), falling) is None
    assert feed(LossRange(0, 0.01), [0.2] * 120) == 100


def test_no_test_stops_early() -> None:
    assert feed(EpochMeans(50, 2, 0.01), [0.5] * 100) == 52


def test_validation_waits_for_its_patience() -> None:
    psnrs = iter([20.0, 25.0, 25.01, 25.02, 25.03])
    test = Validation(0, PaperConfig(validation_every=10, validation_patience=3), lambda: next(psnrs))
    stops = [i for i in range(1, 51) if test.converged(torch.tensor(0.0), i, False)]
    assert stops == [50]


@pytest.mark.parametrize("rule", ["epoch", "validation", "paper"])
def test_state_goes_through_a_checkpoint(rule: str) -> None:
    warmup, paper = WarmupConfig(epoch_span=1), PaperConfig(stop_rule=StopRule(rule), validation_every=1)
    first, second = (make_convergence(warmup, paper, 100, lambda: 1.0) for _ in range(2))
    assert first is not None and second is not None
    for i in range(1, 6):
        first.converged(torch.tensor(0.5), i, i % 2 == 0)
    second.restore(first.state())
    assert second.state() == first.state()
