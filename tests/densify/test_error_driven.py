"""Tests of error-driven growth: where Gaussians are added, how many, and which make room."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from mgsr.config import GaussianDensifyConfig, Growth, make_config, starting_settings
from mgsr.config.expert import ErrorGrowthOptions
from mgsr.data.camera import Camera
from mgsr.densify.contribution import contributions
from mgsr.densify.error_driven import (
    ViewResidual,
    new_points,
    not_contradicted,
    planned_changes,
    visible_error,
    without_least_contributing,
)
from mgsr.errors import ConfigError
from mgsr.gaussians.start import new_gaussians, start_gaussians
from mgsr.training.growth import ErrorGrowth
from mgsr.training.plan import make_plan
from tests.training.ball import ball_points, ball_scene

HEIGHT, WIDTH = 20, 30
CONFIG = make_config().train.gaussians


def turned_camera() -> Camera:
    """Return a camera that looks askew, with its principal point off the middle."""
    angle = 0.7
    pose = np.eye(4)
    pose[:3, :3] = [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    pose[:3, 3] = [0.3, -0.2, 4.0]
    return Camera(np.array([[25.0, 0, 14.0], [0, 25.0, 11.0], [0, 0, 1]]), pose, WIDTH, HEIGHT)


def rendered(wanted: torch.Tensor) -> ViewResidual:
    """Return a grey rendering of a surface 3.5 in front of the camera, beside what it should be."""
    grey = torch.full((HEIGHT, WIDTH, 3), 0.5)
    plane = torch.ones(HEIGHT, WIDTH)
    return ViewResidual(turned_camera(), wanted - grey, grey - 0.1, 3.5 * plane, plane)


def with_patch(color: float) -> ViewResidual:
    """Return a rendering that lacks a patch of 5 x 5 pixels."""
    wanted = torch.full((HEIGHT, WIDTH, 3), 0.5)
    wanted[8:13, 10:15] = color
    return rendered(wanted)


def test_only_what_differs_visibly_counts() -> None:
    assert not visible_error(with_patch(0.53), 0.04).any()
    error = visible_error(with_patch(0.8), 0.04)
    assert error[10, 12] == pytest.approx(0.3, abs=1e-6)
    assert not error[:6].any()
    assert not error[:, 18:].any()


def test_noise_of_single_pixels_counts_less_than_a_patch() -> None:
    noise = 0.08 * torch.randn(HEIGHT, WIDTH, 3, generator=torch.Generator().manual_seed(0))
    noisy = visible_error(rendered(0.5 + noise), 0.04)
    patch = visible_error(rendered(torch.full((HEIGHT, WIDTH, 3), 0.58)), 0.04)
    assert (noisy > 0).float().mean() < 0.1
    assert (patch > 0).all()


def test_pixels_without_a_surface_do_not_count() -> None:
    view = with_patch(0.9)
    view.alpha.zero_()
    assert not visible_error(view, 0.04).any()


def test_options_of_what_counts() -> None:
    """Check that an average over one pixel leaves a patch's border sharp, and that solid is from which alpha on."""
    sharp = visible_error(with_patch(0.8), 0.04, ErrorGrowthOptions(half_window=0))
    assert int((sharp > 0).sum()) == 25 < int((visible_error(with_patch(0.8), 0.04) > 0).sum())
    view = with_patch(0.8)
    view.alpha.fill_(0.5)
    assert visible_error(view, 0.04).any() and not visible_error(view, 0.04, ErrorGrowthOptions(solid=0.6)).any()


def test_growth_takes_its_options() -> None:
    config = make_config(overrides=["error_growth.hidden=7"])
    plan = make_plan(ball_scene(24, train=6), ball_points(300), config)
    growth = [stage.growth for stage in plan.stages if isinstance(stage.growth, ErrorGrowth)]
    assert growth and all(each.options.hidden == 7 for each in growth)


def test_the_number_follows_the_differing_pixels_and_has_bounds() -> None:
    config = GaussianDensifyConfig(growth=0.25, replace=0.1, max_count=1100)
    some = [torch.zeros(10, 10), torch.ones(10, 10)]
    assert planned_changes([torch.zeros(10, 10)], 1000, config) == (0, 0)
    assert planned_changes(some, 400, config) == (40, 50)  # 50 pixels in the mean; a tenth of 400
    assert planned_changes(some, 100, config) == (10, 25)
    assert planned_changes(some, 1090, config) == (50, 10)  # up to max_count
    assert planned_changes(some, 2000, config) == (50, 0)


def test_new_points_project_to_the_pixels_that_differ_at_the_surface() -> None:
    view = with_patch(0.9)
    error = [visible_error(view, 0.04)]
    points = new_points([view], error, 20, torch.Generator().manual_seed(0))
    assert points.positions.shape == (20, 3)
    pose, K = view.camera.cam_from_world, view.camera.K
    seen = points.positions.double().numpy() @ pose[:3, :3].T + pose[:3, 3]
    pixels = (seen @ K.T)[:, :2] / seen[:, 2:]
    np.testing.assert_allclose(seen[:, 2], 3.5, atol=1e-5)
    np.testing.assert_allclose(pixels % 1, 0.5, atol=1e-3)  # pixel centres
    column, row = np.floor(pixels).astype(int).T
    assert (error[0].numpy()[row, column] > 0).all()
    assert len({*zip(column, row, strict=True)}) == 20, "no pixel twice"
    torch.testing.assert_close(points.sizes, torch.full((20,), 3.5 / 25.0))
    # Inside the patch the photograph lacks 0.4, which is added to the Gaussians' own 0.4.
    inside = (column >= 10) & (column < 15) & (row >= 8) & (row < 13)
    assert inside.any()
    torch.testing.assert_close(points.colors[torch.from_numpy(inside)], torch.full((int(inside.sum()), 3), 0.8))


def test_points_come_from_all_views_in_proportion_to_their_errors() -> None:
    views = [rendered(torch.full((HEIGHT, WIDTH, 3), color)) for color in (0.6, 0.9)]
    error = [visible_error(view, 0.04) for view in views]
    dark = 0
    for seed in range(60):
        points = new_points(views, error, 4, torch.Generator().manual_seed(seed))
        dark += int((points.colors[:, 0] < 0.51).sum())
    assert dark / 240 == pytest.approx(0.2, abs=0.08)  # errors of 0.1 and 0.4


def test_fewer_pixels_than_asked_for_give_fewer_points() -> None:
    view = with_patch(0.9)
    error = [visible_error(view, 0.04)]
    most = int((error[0] > 0).sum())
    assert len(new_points([view], error, 10_000, torch.Generator()).positions) == most
    assert not len(new_points([view], [torch.zeros(HEIGHT, WIDTH)], 10, torch.Generator()).positions)


def test_other_views_confirm_what_the_surface_lacks_and_contradict_a_highlight() -> None:
    """Check that views of the same place confirm what the surface lacks, and contradict a highlight.

    They are a camera and others on a wall that faces them all.
    """
    first, second, third = with_patch(0.9), with_patch(0.8), with_patch(0.45)
    drawn = new_points([first], [visible_error(first, 0.04)], 10_000, torch.Generator())
    in_patch = drawn.rows(drawn.residual[:, 0] > 0.3)
    assert len(not_contradicted(in_patch, [first, second]).sizes) == 25
    assert not len(not_contradicted(in_patch, [first, third]).sizes), "the others have too much"
    assert len(not_contradicted(in_patch, [first, second, third]).sizes) == 25, "the sum of the others counts"
    hidden = replace(second, depth=second.depth - 1.0)
    assert not len(not_contradicted(in_patch, [first, hidden]).sizes), "seen by one view alone"
    unknown = replace(second, residual=torch.zeros(HEIGHT, WIDTH, 3))
    assert not len(not_contradicted(in_patch, [first, unknown]).sizes)


def test_those_that_carry_least_make_room() -> None:
    scene = ball_scene(size=24, train=3)
    positions = np.random.default_rng(0).normal(scale=0.3, size=(40, 3))
    model = start_gaussians(positions, None, np.full((40, 3), 0.5), CONFIG, torch.Generator(), split=False)
    nothing = torch.zeros(24, 24)
    views = [ViewResidual(view.camera, *(nothing,) * 4) for view in scene.train]
    kept = without_least_contributing(model, views, 15)
    light = contributions(model, [view.camera for view in scene.train])
    assert len(kept) == 25
    assert (kept.diff() > 0).all()
    gone = torch.ones(40, dtype=torch.bool)
    gone[kept] = False
    assert light[gone].max() <= light[kept].min()


@pytest.mark.parametrize("split", [False, True])
def test_new_gaussians_fit_the_model_that_they_join(split: bool) -> None:
    generator = torch.Generator()
    colors = torch.rand(5, 3)
    model = start_gaussians(np.random.rand(9, 3), None, np.random.rand(9, 3), CONFIG, generator, split)
    new = new_gaussians(model, torch.rand(5, 3), torch.full((5,), 0.02), colors, 0.6, CONFIG)
    assert new.keys() == model.parameters().keys()
    for name, tensor in model.parameters().items():
        assert new[name].shape == (5, *tensor.shape[1:])
    torch.testing.assert_close(new["opacity_logits"].sigmoid(), torch.full((5,), 0.6))
    torch.testing.assert_close(new["log_scales"].exp(), torch.full((5, 3), 0.02))
    torch.testing.assert_close(new["sh"][:, 0] * 0.28209479 + 0.5, colors)


def test_without_masks_the_gradient_tells_with_its_rates_and_a_limit() -> None:
    train = make_config().train
    masked, unmasked = (starting_settings(train, masked, 50_000)[1] for masked in (True, False))
    assert (masked.densify, masked.max_start) == (CONFIG.densify, 10_000)
    assert (masked.rates.scale, masked.rates.beta2) == (0.02, 0.99)
    assert unmasked.rates == CONFIG.rates and unmasked.max_start == 100_000
    assert (unmasked.densify.by, unmasked.densify.max_count) == (Growth.GRADIENT, 75_000)
    many = starting_settings(train, False, 10**6)[1]
    assert (many.max_start, many.densify.max_count) == (100_000, 150_000)


def test_the_gradient_adds_a_share_of_the_starting_points_up_to_the_largest_count() -> None:
    for points, most in ((600, 20_000), (32_000, 40_000), (10**6, 50_000)):
        assert starting_settings(make_config().train, False, points)[0].densify.max_count == most
    assert starting_settings(make_config().train, True, 10**6)[0].densify.max_count == 20_000
    detailed = starting_settings(make_config().train, True, 10**6, detail=2.5)[0]
    assert (detailed.max_start, detailed.densify.max_count) == (40_000, 50_000)
    asked = ["gaussians.densify.by=gradient", "gaussians.densify.max_growth=none", "gaussians.densify.max_count=70000"]
    for masked in (True, False):
        free = starting_settings(make_config(overrides=asked).train, masked, 60_000)[1]
        assert free.densify.max_count == 70_000
    held = make_config(overrides=["surfels.densify.max_count=12000"]).train
    assert starting_settings(held, True, 16_000)[0].densify.max_count == 12_000


def test_bad_settings_are_refused() -> None:
    with pytest.raises(ConfigError, match="does not exist"):
        make_config(overrides=["surfels.densify.by=error"])
    with pytest.raises(ConfigError, match="new_opacity: expected a value between 0 and 1"):
        make_config(overrides=["gaussians.densify.new_opacity=1"])
