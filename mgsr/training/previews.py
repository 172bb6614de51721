"""Pictures of a view while training goes on, for the person who waits."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from mgsr.renderers.both import render_both
from mgsr.training.plan import Plan
from mgsr.training.views import color_tensor


@torch.no_grad()
def preview_pictures(plan: Plan) -> dict[str, np.ndarray]:
    """Render pictures uint8 [H,W,3] of the first view that the curve looks at, or else the first to train on.

    render: of the rendering branch, or the only one; normals: of the surface, world axes as colours, grey off the
    surface; transmitted and reflected: the halves of the light, where it is split.
    """
    view = (plan.curve_views or plan.stages[-1].views)[0]
    color = color_tensor(plan.backdrop.color, plan.train_state.branches[0].device)
    flat, full = render_both(plan.train_state.model, view.camera, color, depth=False, shading=view.shading())
    images: dict[str, Tensor] = {}
    if flat is not None:
        images = {"render": flat.color, "normals": flat.normal * 0.5 + 0.5}
    if full is not None:
        images["render"] = full.color
        if full.reflected is not None and full.weight is not None:
            images |= {"transmitted": full.transmitted, "reflected": full.weight[..., None] * full.reflected}
    return {name: (image.clamp(0, 1) * 255).round().to(torch.uint8).cpu().numpy() for name, image in images.items()}
