"""Error-driven growth of the 3D branch, where its renderings differ from the photographs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch

from mgsr.config import GaussianConfig
from mgsr.config.expert import ErrorGrowthOptions
from mgsr.data.backdrop import Color
from mgsr.densify.error_driven import (
    ViewResidual,
    new_points,
    not_contradicted,
    planned_changes,
    visible_error,
    without_least_contributing,
)
from mgsr.gaussians.start import new_gaussians
from mgsr.renderers.both import render_both
from mgsr.training.stages import GaussianBranch
from mgsr.training.train_state import TrainState
from mgsr.training.views import TrainingView, color_tensor


@dataclass(frozen=True)
class ErrorGrowth:
    """The growth of `branch`, a branch of `train_state`.

    behind: the colour behind the compared renderings and photographs. options: those of error-driven growth.
    """

    branch: GaussianBranch
    train_state: TrainState
    config: GaussianConfig
    behind: Color
    options: ErrorGrowthOptions = ErrorGrowthOptions()

    def grow(self, views: Sequence[TrainingView]) -> None:
        """Prune Gaussians, and then replace and add some where renderings of a few views differ from the photographs.

        The branch's generator draws the views. Raises TrainingError when no Gaussian is left.
        """
        branch, densify = self.branch, self.config.densify
        branch.adapt(grow=False)
        drawn = torch.randperm(len(views), generator=branch.generator)[: densify.growth_views].tolist()
        rendered = [self._rendered(views[index]) for index in drawn]
        error = [visible_error(view, densify.tolerance, self.options) for view in rendered]
        replaced, added = planned_changes(error, len(branch.model), densify)
        found = new_points(rendered, error, replaced + added, branch.generator)
        points = not_contradicted(found, rendered, self.options.hidden)
        if not len(points.positions):
            return
        kept = without_least_contributing(branch.model, rendered, min(replaced, len(points.positions)))
        new = new_gaussians(
            branch.model, points.positions, points.sizes, points.colors, densify.new_opacity, self.config
        )
        branch.exchange(kept, new)

    @torch.no_grad()
    def _rendered(self, view: TrainingView) -> ViewResidual:
        behind = color_tensor(self.behind, self.branch.device)
        _, shown = render_both(self.train_state.model.for_gaussians(), view.camera, behind, shading=view.shading())
        assert shown is not None and shown.depth is not None
        target = view.target(behind)
        color, target_color = target.compared(shown.color, target.color_beside(shown.color))
        base = shown.transmitted if shown.unlit is None else shown.unlit
        return ViewResidual(view.camera, target_color - color, base, shown.depth, target.valid_weights(shown.alpha))
