"""Building blocks of losses beside the image kernels: targets, coverage, and terms of single numbers."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from mgsr.checks import check_tensors
from mgsr.native.cuda.launcher import launcher_for
from mgsr.native.cuda.terms import Region, Sums, TermKernels
from mgsr.native.structs import CompositedImage, ImageInBytes, WeightedDifference
from mgsr.ops.arrays import plain
from mgsr.ops.terms import Slope, Term, Total, needs_gradient

LEAST = 1e-4  # the lower limit of alpha and of 1 - alpha in a cross entropy


def composite(
    image: Tensor, mask: Tensor, background: Tensor, off_edge: Tensor | None = None, region: Region | None = None
) -> tuple[Tensor, Tensor, Tensor | None]:
    """Composite a photograph on a colour; return color [H,W,3], alpha [H,W] in 0..1, and off_edge [H,W] as 0 or 1.

    image [H,W,3]: uint8, straight colours.
    mask [H,W]: uint8.
    background [3].
    off_edge [H,W]: bool.
    region: (y0, y1, x0, x1), ends excluded; the mask is 0 outside.
    """
    height, width = mask.shape
    launcher = launcher_for(background)
    if launcher is not None:
        color, alpha = background.new_empty(height, width, 3), background.new_empty(height, width)
        weights = None if off_edge is None else torch.empty_like(alpha)
        edge = None if off_edge is None else plain(off_edge)
        photograph = ImageInBytes(image=plain(image), mask=plain(mask), off_edge=edge)
        out = CompositedImage(color=color, alpha=alpha, weights=weights)
        TermKernels(launcher).composite(photograph, plain(background), out)
        return color, alpha, weights
    # Filling whole rows and then compositing only the mask's pixels is faster than compositing every pixel.
    color = background.repeat(width).expand(height, -1).contiguous().view(height, width, 3)
    alpha = mask / 255
    y0, y1, x0, x1 = region or (0, height, 0, width)
    color[y0:y1, x0:x1] += (image[y0:y1, x0:x1] / 255).sub_(background).mul_(alpha[y0:y1, x0:x1, None])
    return color, alpha, None if off_edge is None else off_edge.to(alpha.dtype)


def covered(alpha: Tensor, mask: Tensor | None = None) -> Tensor:
    """Return 1 where alpha [H,W] and, if given, the mask [H,W] are over a half, else 0: [H,W] float32, no gradient."""
    alpha = plain(alpha)
    launcher = launcher_for(alpha)
    if launcher is None:
        inside = alpha > 0.5
        return (inside if mask is None else inside & (mask > 0.5)).to(alpha.dtype)
    result = torch.empty_like(alpha)
    TermKernels(launcher).covered(alpha, None if mask is None else plain(mask), result)
    return result


def silhouette_term(alpha: Tensor, mask: Tensor, weights: Tensor | None = None, entropy: bool = False) -> Term:
    """Return the mean over all pixels of |alpha - mask|, or with `entropy` of the cross entropy.

    alpha [H,W]: in 0..1; gradients flow. The cross entropy clips it to 1e-4..1 - 1e-4.
    mask [H,W]: in 0..1.
    weights [H,W]: factors on both before they are compared.

    Raises TensorError for wrong shapes or dtypes.
    """
    check_tensors(alpha=(alpha, "H W"), mask=(mask, "H W"), weights=(weights, "? H W"))
    own, other, by = plain(alpha), plain(mask), None if weights is None else plain(weights)
    v_alpha = torch.empty_like(own) if needs_gradient(alpha)[0] else None
    launcher = launcher_for(own)
    if launcher is not None:
        sums = TermKernels(launcher).silhouette(own, other, by, entropy, v_alpha)
        return Term(sums, () if v_alpha is None else (Slope(alpha, v_alpha),))
    if by is not None:
        own, other = own * by, other * by
    total, slopes = _cross_entropy(own, other) if entropy else _absolute(own, other)
    if v_alpha is None:
        return Term(Total(total, own.numel()), ())
    return Term(Total(total, own.numel()), (Slope(alpha, slopes if by is None else slopes.mul_(by)),))


def squares_term(
    a: Tensor,
    b: Tensor | None = None,
    weights: tuple[Tensor | None, Tensor | None] = (None, None),
    offset: float = 0.0,
    by: float | Tensor = 1.0,
) -> Term:
    """Return the sum of the squares of (a - b) * weights - offset, divided by `by`.

    a, b: [...], of the same shape; gradients flow. weights: two tensors of that shape, each 0 or 1; None means 1. With
    an offset, both must be None. by: a number, or a tensor [] float32, which the host does not read.

    Raises TensorError for wrong dtypes or shapes.
    """
    of_a, of_b = needs_gradient(a)[0], b is not None and needs_gradient(b)[0]
    shape = " ".join(str(size) for size in a.shape)
    optional = "? " + shape
    check_tensors(a=(a, shape), b=(b, optional), first=(weights[0], optional), second=(weights[1], optional))
    own, other, first, second = plain(a), *(None if each is None else plain(each) for each in (b, *weights))
    launcher = launcher_for(own)
    sums: Total | Sums
    if launcher is None:
        sums, differences = _squares(own, other, (first, second), offset, by)
    else:
        differences = torch.empty_like(own)
        number, divisor = (1.0, by) if isinstance(by, Tensor) else (by, None)
        difference = WeightedDifference(a=own, b=other, first=first, second=second, offset=offset)
        sums = TermKernels(launcher).squares(difference, number, divisor, differences)
    # Weights are 0 or 1 and the differences already contain them, so no second multiplication is needed.
    slopes = [Slope(a, differences, 2.0)] if of_a else []
    return Term(sums, (*slopes, *([Slope(b, differences, -2.0)] if b is not None and of_b else [])))


def product_term(weight: Tensor, color: Tensor) -> Term:
    """Return the mean over pixels and channels of weight [H,W] times color [H,W,3]; gradients flow to both.

    Raises TensorError for wrong shapes or dtypes.
    """
    check_tensors(weight=(weight, "H W"), color=(color, "H W 3"))
    factor, image = plain(weight), plain(color)
    launcher = launcher_for(factor)
    sums: Total | Sums
    if launcher is None:
        sums_of_color = image @ torch.ones(3)
        sums = Total(float(factor.reshape(-1) @ sums_of_color.reshape(-1)), image.numel())
    else:
        sums_of_color = torch.empty_like(factor)
        sums = TermKernels(launcher).product(factor, image, sums_of_color)
    of_weight, of_color = needs_gradient(weight, color)
    return Term(sums, (*[Slope(weight, sums_of_color)] * of_weight, *[Slope(color, factor)] * of_color))


def steps_term(maps: Tensor) -> Term:
    """Return the mean square of the steps between rows plus that between columns in maps [M,S,S,C]; gradients flow.

    It is 0 for maps of one texel. Raises TensorError for a wrong shape or dtype.
    """
    sizes = check_tensors(maps=(maps, "M S S C"))
    values, by = plain(maps), sizes["M"] * sizes["S"] * (sizes["S"] - 1) * sizes["C"]
    launcher = launcher_for(values)
    sums: Total | Sums
    if launcher is None:
        total, v_maps = _steps(values)
        sums = Total(total, by)
    else:
        v_maps = torch.empty_like(values)
        sums = TermKernels(launcher).steps(values, by, v_maps)
    return Term(sums, (Slope(maps, v_maps),) if needs_gradient(maps)[0] else ())


def _absolute(alpha: Tensor, mask: Tensor) -> tuple[float, Tensor]:
    """Return the sum of |alpha - mask| over pixels [H,W], and its derivative [H,W]."""
    difference = alpha - mask
    slopes = difference.sign()
    return float(difference.reshape(-1) @ slopes.reshape(-1)), slopes


def _cross_entropy(alpha: Tensor, mask: Tensor) -> tuple[float, Tensor]:
    """Return the sum of the cross entropy of alpha and a mask [H,W], and its derivative [H,W]."""
    inside = alpha.clamp(LEAST, 1 - LEAST)
    total = torch.nn.functional.binary_cross_entropy(inside, mask, reduction="sum")
    slopes = (inside - mask) / (inside * (1 - inside))
    return float(total), slopes.mul_(inside == alpha)


def _squares(
    a: Tensor, b: Tensor | None, weights: tuple[Tensor | None, Tensor | None], offset: float, by: float | Tensor
) -> tuple[Total, Tensor]:
    """Return the sum of squares with its divisor, and the differences [...] of a's shape (see `squares_term`)."""
    differences = a if b is None else a - b
    for weight in weights:
        differences = differences if weight is None else differences * weight
    differences = differences - offset if offset else differences
    flat = differences.reshape(-1)
    return Total(float(flat @ flat), float(by)), differences


def _steps(maps: Tensor) -> tuple[float, Tensor]:
    """Return the sum of the squared steps of maps [M,S,S,C], and its gradient of the same shape."""
    down, right = maps[:, 1:] - maps[:, :-1], maps[:, :, 1:] - maps[:, :, :-1]
    v_maps = torch.zeros_like(maps)
    v_maps[:, 1:].add_(down, alpha=2)
    v_maps[:, :-1].sub_(down, alpha=2)
    v_maps[:, :, 1:].add_(right, alpha=2)
    v_maps[:, :, :-1].sub_(right, alpha=2)
    return math.fsum(float(step.square().sum()) for step in (down, right)), v_maps
