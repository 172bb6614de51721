"""The space around cameras that is kept free."""

from __future__ import annotations

import numpy as np
import torch

from mgsr.config import make_config
from mgsr.densify.clearance import Clearance
from mgsr.training.plan import make_plan
from tests.training.ball import RADIUS, ball_points, ball_scene


def test_what_lies_within_half_of_the_way_to_the_nearest_points_goes() -> None:
    cameras = [view.camera for view in ball_scene(24, train=6).train]  # 2.5 from the origin
    points = np.tile([[0.0, 0.0, 0.0]], (10, 1))
    clearance = Clearance.around(cameras, points, 0.5)
    inward = -cameras[2].center / np.linalg.norm(cameras[2].center)
    along = torch.tensor(cameras[2].center + np.array([[0.0], [1.2], [1.3], [2.5], [-1.2], [-1.3]]) * inward)
    assert clearance.outside(along.float()).tolist() == [2, 3, 5]


def test_single_points_near_a_camera_do_not_count() -> None:
    cameras = [view.camera for view in ball_scene(24, train=6).train]
    points = np.concatenate([np.zeros((20, 3)), cameras[0].center[None] + 0.1])
    assert float(Clearance.around(cameras, points, 0.5).radii.min()) > 1.2
    assert float(Clearance.around(cameras, points, 0.5, rank=1).radii.min()) < 0.1, "unless the first one is asked for"


def test_only_scenes_without_masks_are_cleared() -> None:
    for masked in (True, False):
        plan = make_plan(ball_scene(24, train=6, masked=masked), ball_points(300, RADIUS), make_config("draft"))
        assert all((stage.clearance is None) == masked for stage in plan.stages if stage.name != "finish")


def test_a_round_of_densification_clears() -> None:
    scene = ball_scene(24, train=6, masked=False)
    plan = make_plan(scene, ball_points(300, RADIUS), make_config("draft"))
    stage, branch = plan.stages[1], plan.train_state.gaussians
    with torch.no_grad():
        assert branch is not None
        branch.model.means[0] = torch.tensor(scene.train[0].camera.center * 0.9, dtype=torch.float32)
    stage.adapt(branch)
    assert len(branch.model) == 299
