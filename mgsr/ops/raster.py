"""Parts that both rasterizers share: a rendering as one node of torch's graph, and statistics of its splats."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import torch
from torch import Tensor

from mgsr.ops.arrays import once_differentiable, plain


@dataclass
class SplatStats:
    """Statistics of each splat in one render.

    radii [N]: pixels, 0 where culled; v_means2d [N,2]: once backward has run, the gradient of the loss to each
    projected centre in pixels.
    """

    radii: Tensor
    v_means2d: Tensor | None = field(default=None)

    @property
    def visible(self) -> Tensor:
        """Return which splats were not culled, [N] bool."""
        return self.radii > 0


class RasterPass(Protocol):
    """One rendering, forward and back, outside the graph.

    splats: its tensors, contiguous, the background last.
    """

    def forward(self, splats: Sequence[Any]) -> tuple[Tensor | None, ...]:
        """Return the images, [H,W] or [H,W,3]: colour and alpha, then others."""

    def backward(
        self, splats: Sequence[Any], images: Sequence[Tensor | None], v_images: Sequence[Tensor | None]
    ) -> Sequence[Tensor | None]:
        """Return the splat tensors' gradients [N,...], except the background's, given those of the images.

        Each image's gradient, [H,W] or [H,W,3], is contiguous or None.
        """


class Rasterize(torch.autograd.Function):
    """A pass over tensors as its `forward` takes them, with gradients, also of the background."""

    @staticmethod
    def forward(ctx: Any, pass_: RasterPass, *tensors: Tensor | None) -> tuple[Tensor | None, ...]:
        """Return the images [H,W] or [H,W,3] of a pass over splat tensors [N,...] and a background [3]."""
        splats = [t if t is None else plain(t) for t in tensors]
        images = pass_.forward(splats)
        ctx.pass_, ctx.splats = pass_, splats
        ctx.save_for_backward(*images)
        ctx.set_materialize_grads(False)
        return images

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *v_outputs: Tensor | None) -> tuple[Any, ...]:
        """Return the gradients of all tensors from those of the images [H,W] or [H,W,3]."""
        images, v_images = ctx.saved_tensors, [v if v is None else plain(v) for v in v_outputs]
        v_splats = ctx.pass_.backward(ctx.splats, images, v_images)
        v_background = None
        if ctx.needs_input_grad[-1] and v_images[0] is not None:
            v_background = (v_images[0] * (1 - images[1])[..., None]).sum((0, 1))
        return None, *v_splats, v_background
