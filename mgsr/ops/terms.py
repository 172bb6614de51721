"""Loss terms with their derivatives, evaluated as one node of the graph.

A term's kernel computes its value and its derivative for each image in one pass. Derivatives are scaled and added once,
for all terms together, so an image that five terms use gets its gradient in one pass. A training step has one node in
the graph instead of dozens.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from mgsr.native import _terms
from mgsr.native.cuda.launcher import launcher_for
from mgsr.native.cuda.terms import Image, Part, Sums, TermKernels
from mgsr.ops.arrays import once_differentiable, plain


@dataclass(slots=True)
class Total:
    """A term's sum and its divisor, as the CPU's kernels return them; 0 over 0 counts as 0."""

    total: float
    by: float


@dataclass(slots=True)
class Slope:
    """A term's derivative for one tensor of the graph.

    The derivative of the term's sum is factor * values, which has the image's shape or one number per pixel.
    """

    image: Tensor
    values: Tensor
    factor: float = 1.0


@dataclass(slots=True)
class Term:
    """A loss term: a number to minimise, times a weight.

    A number times a term is a term. `float` returns its value, and `scalar` returns it as a tensor with gradients.
    """

    sums: Total | Sums
    slopes: tuple[Slope, ...]
    weight: float = 1.0

    def __rmul__(self, factor: float) -> Term:
        return Term(self.sums, self.slopes, factor * self.weight)

    def __float__(self) -> float:
        return float(scalar(self))


def needs_gradient(*tensors: Tensor) -> list[bool]:
    """Return for each of the tensors whether it needs a gradient."""
    return [torch.is_grad_enabled() and tensor.requires_grad for tensor in tensors]


def scalar(term: Term) -> Tensor:
    """Return the term's weighted value []; gradients flow to its images."""
    return evaluate([term])[0]


def evaluate(terms: Sequence[Term]) -> Tensor:
    """Return the weighted values [T] of terms of one device; gradients flow to their images."""
    images: dict[int, Tensor] = {id(slope.image): slope.image for term in terms for slope in term.slopes}
    values: Tensor = _Evaluate.apply(tuple(terms), list(images), *images.values())
    return values


class _Evaluate(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, terms: tuple[Term, ...], keys: list[int], *images: Tensor) -> Tensor:
        """Return the weighted values [T] of terms over their images [H,W] or [H,W,C]."""
        ctx.kernels, values, ctx.scales = _values(terms)
        slopes = [(number, slope) for number, term in enumerate(terms) for slope in term.slopes]
        ctx.shapes = [image.shape for image in images]
        ctx.described = [(keys.index(id(each.image)), number, each.factor) for number, each in slopes]
        ctx.save_for_backward(*(slope.values for _, slope in slopes))
        return values

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, v_values: Tensor) -> tuple[Any, ...]:
        """Return the images' gradients, in their shapes, given those of the values [T]."""
        images = [Image(shape) for shape in ctx.shapes]
        for (image, number, factor), values in zip(ctx.described, ctx.saved_tensors, strict=True):
            images[image].parts.append(Part(values, number, factor))
        if ctx.kernels is not None:
            return None, None, *ctx.kernels.gradients(images, v_values.contiguous(), ctx.scales)
        scales = [scale * v for scale, v in zip(ctx.scales, v_values.tolist(), strict=True)]
        return None, None, *(_added_up(image, scales) for image in images)


def _values(terms: Sequence[Term]) -> tuple[TermKernels | None, Tensor, Any]:
    """Evaluate terms of one device. Return the kernels that add their slopes, the values [T], and the slopes' scales.

    The kernels are None on the CPU.
    """
    on_gpu = [(term.sums, term.weight) for term in terms if isinstance(term.sums, Sums)]
    if on_gpu:
        assert len(on_gpu) == len(terms), "all terms of a loss must be on one device"
        launcher = launcher_for(on_gpu[0][0].partial)
        assert launcher is not None
        kernels = TermKernels(launcher)
        return kernels, *kernels.totals(on_gpu)
    sums = [(term.sums, term.weight) for term in terms if isinstance(term.sums, Total)]
    scales = [weight / each.by if each.by else 0.0 for each, weight in sums]
    values = [each.total * scale for (each, _), scale in zip(sums, scales, strict=True)]
    return None, torch.tensor(values, dtype=torch.float32), scales


def _added_up(image: Image, scales: list[float]) -> Tensor:
    """Return the gradient [...] of an image: the sum of its parts, each times the scale of its term."""
    gradient = torch.empty(image.shape)
    _terms.gradient(
        [plain(part.slopes) for part in image.parts],
        [part.factor * scales[part.term] for part in image.parts],
        gradient,
    )
    return gradient
