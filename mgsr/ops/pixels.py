"""Building blocks of losses beside the image kernels: targets, coverage, and terms of single numbers."""

from __future__ import annotations

import torch
from torch import Tensor

from mgsr.checks import check_tensors
from mgsr.native import _terms
from mgsr.native.cuda.launcher import launcher_for
from mgsr.native.cuda.terms import Sums, TermKernels
from mgsr.native.structs import CompositedImage, ImageInBytes, WeightedDifference
from mgsr.ops.arrays import plain
from mgsr.ops.terms import Slope, Term, Total, needs_gradient


def composite(
    image: Tensor, mask: Tensor, background: Tensor, off_edge: Tensor | None = None
) -> tuple[Tensor, Tensor, Tensor | None]:
    """Composite a photograph on a colour; return color [H,W,3], alpha [H,W] in 0..1, and off_edge [H,W] as 0 or 1.

    image [H,W,3]: uint8, straight colours.
    mask [H,W]: uint8.
    background [3].
    off_edge [H,W]: bool.
    """
    behind, launcher = plain(background), launcher_for(background)
    color, alpha = behind.new_empty(*mask.shape, 3), behind.new_empty(mask.shape)
    weights, edge = (None, None) if off_edge is None else (torch.empty_like(alpha), plain(off_edge))
    photograph = ImageInBytes(image=plain(image), mask=plain(mask), off_edge=edge)
    out = CompositedImage(color=color, alpha=alpha, weights=weights)
    if launcher is None:
        _terms.composite(photograph, behind, out)
    else:
        TermKernels(launcher).composite(photograph, behind, out)
    return color, alpha, weights


def covered(alpha: Tensor, mask: Tensor | None = None) -> Tensor:
    """Return 1 where alpha [H,W] and, if given, the mask [H,W] are over a half, else 0: [H,W] float32, no gradient."""
    alpha, other = plain(alpha), None if mask is None else plain(mask)
    launcher, result = launcher_for(alpha), torch.empty_like(alpha)
    if launcher is None:
        _terms.covered(alpha, other, result)
    else:
        TermKernels(launcher).covered(alpha, other, result)
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
    sums: Total | Sums
    if launcher is None:
        sums = Total(_terms.silhouette(own, other, by, entropy, v_alpha), own.numel())
    else:
        sums = TermKernels(launcher).silhouette(own, other, by, entropy, v_alpha)
    return Term(sums, () if v_alpha is None else (Slope(alpha, v_alpha),))


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
    launcher, differences = launcher_for(own), torch.empty_like(own)
    difference = WeightedDifference(a=own, b=other, first=first, second=second, offset=offset)
    sums: Total | Sums
    if launcher is None:
        sums = Total(_terms.squares(difference, differences), float(by))
    else:
        number, divisor = (1.0, by) if isinstance(by, Tensor) else (by, None)
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
    launcher, sums_of_color = launcher_for(factor), torch.empty_like(factor)
    sums: Total | Sums
    if launcher is None:
        sums = Total(_terms.product(factor, image, sums_of_color), image.numel())
    else:
        sums = TermKernels(launcher).product(factor, image, sums_of_color)
    of_weight, of_color = needs_gradient(weight, color)
    return Term(sums, (*[Slope(weight, sums_of_color)] * of_weight, *[Slope(color, factor)] * of_color))


def steps_term(maps: Tensor) -> Term:
    """Return the mean square of the steps between rows plus that between columns in maps [M,S,S,C]; gradients flow.

    It is 0 for maps of one texel. Raises TensorError for a wrong shape or dtype.
    """
    sizes = check_tensors(maps=(maps, "M S S C"))
    values, by = plain(maps), sizes["M"] * sizes["S"] * (sizes["S"] - 1) * sizes["C"]
    launcher, v_maps = launcher_for(values), torch.empty_like(values)
    sums: Total | Sums
    if launcher is None:
        sums = Total(_terms.steps(values, v_maps), by)
    else:
        sums = TermKernels(launcher).steps(values, by, v_maps)
    return Term(sums, (Slope(maps, v_maps),) if needs_gradient(maps)[0] else ())
