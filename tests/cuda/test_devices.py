"""An iteration of training touches one device and never waits for it.

Torch's meta device stands in for a GPU: an operation that mixes it with the processor's tensors fails there, and so
does everything that would bring a value to the host (float, bool, item, cpu, numpy, a mask's count).
"""

from __future__ import annotations

import ctypes

import pytest
import torch

from mgsr.config import Config, make_config
from mgsr.errors import TensorError
from mgsr.native.cuda import tiles
from mgsr.native.cuda.launcher import use_launcher
from mgsr.ops.adam import any_bad
from mgsr.ops.depth_normals import depth_to_normals
from mgsr.ops.image_loss import image_loss
from mgsr.ops.tv import edge_aware_tv
from mgsr.training.plan import Plan, make_plan
from mgsr.training.stages import Stage
from mgsr.training.trainable import step_trainables
from tests.training.ball import ball_points, ball_scene

META = torch.device("meta")


class NoLauncher:
    """A launcher that runs nothing and notes what it was asked for."""

    def __init__(self) -> None:
        self.launched: list[str] = []

    def launch(self, family: str, kernel: str, blocks: int, threads: int, params: ctypes.Structure) -> None:
        assert blocks >= 0 and threads > 0
        self.launched.append(kernel)


@pytest.fixture
def launcher(monkeypatch: pytest.MonkeyPatch) -> NoLauncher:
    """Return a launcher that runs nothing.

    The count of pairs, the one number that a rendering waits for, is put in by hand.
    """
    monkeypatch.setattr(tiles, "read_later", lambda scalar: lambda: 1000)
    return NoLauncher()


def plan_on_meta(config: Config, masked: bool) -> Plan:
    return make_plan(ball_scene(24, train=3, test=1, masked=masked), ball_points(80), config, META)


def iterate(stage: Stage) -> None:
    """Do an iteration as Trainer._iterate and _update do between two densifications."""
    view = stage.views[0]
    step = stage.compute(view, (0.1, 0.2, 0.3), stage.iterations)
    step.loss.backward()
    gradients = [tensor for part in stage.trainables for tensor in part.tensors("grad").values()]
    bad = any_bad([step.loss.values, *gradients])
    step_trainables(dict.fromkeys(stage.trainables, 0.5), bad)
    for branch in stage.branches:
        for render in step.renders:
            if render.branch is branch:
                branch.gather(render.stats, view.camera.width, view.camera.height, render.weight, bad)
    if stage.convergence is not None:
        stage.convergence.converged(step.loss.value.detach(), 1, False)
    assert step.loss.values.device == META


@pytest.mark.parametrize("masked", [True, False])
@pytest.mark.parametrize("overrides", [[], ["distortion_weight=1.0"], ["gaussian_depth_tv_weight=0.1"]])
def test_an_iteration_stays_on_the_gpu(launcher: NoLauncher, masked: bool, overrides: list[str]) -> None:
    plan = plan_on_meta(make_config("standard", "mgsr", 0, overrides), masked)
    with use_launcher(launcher):
        for stage in plan.stages:
            iterate(stage)
    assert plan.train_state.environment_map is not None and plan.train_state.environment_map.model.logits.device == META
    for branch in plan.train_state.branches:
        assert all(tensor.device == META for tensor in branch.model.parameters().values())
        assert branch.densify_state.seen.device == META
    expected = {
        "adam_update",
        "statistics_gather",
        "image_loss",
        "tiles_sum",
        "harmonics_backward_3",
        "environment_map_texels",
    }
    assert expected <= set(launcher.launched)


@pytest.mark.parametrize("method", ["2dgs", "3dgs"])
def test_single_branches_too(launcher: NoLauncher, method: str) -> None:
    plan = plan_on_meta(make_config("high", method, 0, []), masked=True)
    with use_launcher(launcher):
        for stage in plan.stages:
            iterate(stage)


def test_tensors_of_two_devices_are_refused() -> None:
    """Check that tensors of two devices are refused: a kernel would read the processor's addresses as the GPU's."""
    image, plane, here = torch.zeros(4, 5, 3, device=META), torch.zeros(4, 5, device=META), torch.zeros(4, 5)
    camera = ball_scene(24, train=3, test=1).train[0].camera.resized(5, 4)
    with pytest.raises(TensorError, match="mask: expected device meta"):
        image_loss(image, image, mask=here)
    with pytest.raises(TensorError, match="mask: expected device meta"):
        edge_aware_tv(plane, image, here)
    with pytest.raises(TensorError, match="alpha: expected device meta"):
        depth_to_normals(plane, camera, here)
