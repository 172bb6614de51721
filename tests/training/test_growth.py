"""Growth of the 3D branch in a training."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from mgsr.config import Config, make_config
from mgsr.training.plan import Plan, make_plan
from mgsr.training.run import Training
from tests.optional import present
from tests.training.ball import RADIUS, ball_points, ball_scene

SHORT = ["surfel_iterations=10", "gaussian_iterations=60", "mutual.iterations=10", "stop_rule=none", "reflection=off"]
OFTEN = ["gaussians.densify.every=10", "gaussians.densify.start=0.1"]


def config(*overrides: str) -> Config:
    return make_config("draft", overrides=[*SHORT, *OFTEN, *overrides])


def plan(masked: bool = True, *overrides: str) -> Plan:
    return make_plan(ball_scene(48, train=16, masked=masked), ball_points(300, RADIUS), config(*overrides))


def test_at_most_a_share_of_the_count_is_added() -> None:
    made = plan(True, "gaussians.densify.replace=0")
    stage, branch = made.stages[1], made.train_state.gaussians
    assert branch is not None
    before = branch.model.means.detach().clone()
    stage.adapt(branch)
    assert 350 < len(branch.model) <= 450  # half more, without what other views contradict
    torch.testing.assert_close(branch.model.means[:300].detach(), before)


def test_gaussians_are_added_on_the_surface() -> None:
    """Check that Gaussians are added within a pixel of the surface, 0.026 there, which is a new Gaussian's own size."""
    dense = config("gaussians.densify.replace=0", "gaussians.start_scale=0.5", "gaussians.start_opacity=0.95")
    made = make_plan(ball_scene(48, train=16), ball_points(3000, RADIUS), dense)
    stage, branch = made.stages[1], made.train_state.gaussians
    assert branch is not None
    stage.adapt(branch)
    added = branch.model.means[3000:].detach().norm(dim=1)
    assert len(added) > 100
    assert (added - RADIUS).abs().median() < 0.026


def test_gaussians_are_replaced_without_changing_the_count() -> None:
    made = plan(True, "gaussians.densify.growth=0")
    stage, branch = made.stages[1], made.train_state.gaussians
    assert branch is not None
    before = {tuple(row) for row in branch.model.means.tolist()}
    stage.adapt(branch)
    assert len(branch.model) == 300
    # A tenth is new, without what other views contradict.
    assert 270 <= len(before & {tuple(row) for row in branch.model.means.tolist()}) < 290


def test_nothing_is_added_where_all_is_within_the_tolerance() -> None:
    made = plan(True, "gaussians.densify.tolerance=1")
    stage, branch = made.stages[1], made.train_state.gaussians
    assert branch is not None
    stage.adapt(branch)
    assert len(branch.model) == 300


def test_nothing_is_added_for_what_photographs_do_not_show() -> None:
    scene = ball_scene(48, train=16)
    hidden = [replace(view, valid_mask=np.zeros((48, 48), bool)) for view in scene.train]
    made = make_plan(replace(scene, train=hidden), ball_points(300, RADIUS), config())
    stage, branch = made.stages[1], made.train_state.gaussians
    assert branch is not None
    stage.adapt(branch)
    assert len(branch.model) == 300


def test_the_surfels_and_scenes_without_masks_go_by_the_gradient() -> None:
    masked, unmasked = plan(True), plan(False)
    assert masked.stages[1].growth is not None
    assert masked.stages[1].growth.branch is masked.train_state.gaussians
    assert masked.stages[0].growth is None
    assert all(stage.growth is None for stage in unmasked.stages)
    assert unmasked.train_state.gaussians is not None
    assert masked.train_state.gaussians.settings.beta2 == 0.99
    assert unmasked.train_state.gaussians.settings.beta2 == 0.999
    assert masked.train_state.gaussians.densify.max_count == 1_000_000
    assert unmasked.train_state.gaussians.densify.max_count == round(1.5 * config().train.gaussians.max_start)


def test_a_finer_tolerance_ends_with_more_gaussians_and_a_smaller_loss() -> None:
    scene, points = ball_scene(48, train=16), ball_points(300, RADIUS)
    coarse, fine = (
        Training(scene, points, config(f"gaussians.densify.tolerance={value}")).run() for value in (0.2, 0.02)
    )
    coarse_gaussians, fine_gaussians = coarse.model.gaussians, fine.model.gaussians
    assert fine_gaussians is not None and coarse_gaussians is not None
    assert len(fine_gaussians) > len(coarse_gaussians)
    assert present(fine.curve[-1].psnr_gaussians) > present(coarse.curve[-1].psnr_gaussians)
