"""Parts that both rasterizers share: a rendering as one node of torch's graph, and statistics of its splats."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Protocol

import torch
from torch import Tensor

from mgsr.ops.arrays import once_differentiable, plain


@dataclass
class SplatStats:
    """Statistics of each splat in one render.

    radii [N]: pixels, 0 for culled splats. v_means2d [N,2]: the gradient of the loss with respect to each projected
    centre in pixels, once backward has run.
    """

    radii: Tensor
    v_means2d: Tensor | None = field(default=None)

    @property
    def visible(self) -> Tensor:
        """Return which splats are not culled, [N] bool."""
        return self.radii > 0


class RasterPass(Protocol):
    """One rendering, forward and backward, outside the graph.

    Splats, Images, ImageGradients: the structs of its kernels (see `mgsr.native.structs`), which are named tuples of
    contiguous tensors. The background comes last in Splats, colour and alpha first in Images.
    """

    Splats: Any
    Images: Any
    ImageGradients: Any

    def forward(self, splats: Any) -> tuple[Tensor | None, ...]:
        """Return the Images, [H,W] or [H,W,3]."""

    def backward(self, splats: Any, images: Any, v_images: Any) -> tuple[Tensor | None, ...]:
        """Return the splats' gradients [N,...], and last those of their shifts in the image, given v_images."""


class Rasterize(torch.autograd.Function):
    """The autograd function of a pass. It takes the tensors of the pass, and differentiates them and the background."""

    @staticmethod
    def forward(ctx: Any, pass_: RasterPass, *tensors: Tensor | None) -> tuple[Tensor | None, ...]:
        """Return the images [H,W] or [H,W,3] of a pass over splat tensors [N,...] and a background [3]."""
        splats = pass_.Splats._make(t if t is None else plain(t) for t in tensors)
        images = pass_.forward(splats)
        ctx.pass_, ctx.splats = pass_, splats
        ctx.save_for_backward(*images)
        ctx.set_materialize_grads(False)
        return images

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *v_outputs: Tensor | None) -> tuple[Any, ...]:
        """Return the gradients of all tensors, given those of the images [H,W] or [H,W,3]."""
        images = ctx.pass_.Images._make(ctx.saved_tensors)
        v_images = ctx.pass_.ImageGradients._make(v if v is None else plain(v) for v in v_outputs)
        *v_splats, _ = ctx.pass_.backward(ctx.splats, images, v_images)
        v_background = None
        if ctx.needs_input_grad[-1] and v_images.color is not None:
            v_background = (v_images.color * (1 - images.alpha)[..., None]).sum((0, 1))
        return None, *v_splats, v_background
