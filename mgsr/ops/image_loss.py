"""The render loss: L1 and structural similarity in one pass, with the gradient."""

from __future__ import annotations

import torch

from mgsr.checks import check_tensors
from mgsr.errors import TensorError
from mgsr.native import _image
from mgsr.native.cuda.image import ImageKernels
from mgsr.native.cuda.launcher import launcher_for
from mgsr.native.cuda.terms import Sums
from mgsr.native.structs import ImagePair
from mgsr.ops.arrays import plain
from mgsr.ops.terms import Slope, Term, Total, needs_gradient, scalar


def image_loss(
    image: torch.Tensor,
    target: torch.Tensor,
    l1_weight: float = 0.8,
    mask: torch.Tensor | None = None,
) -> torch.Tensor:
    """Return the value [] of `image_loss_term`; gradients flow.

    image, target [H,W,3] and mask [H,W]: as in `image_loss_term`, as are the other arguments.
    """
    return scalar(image_loss_term(image, target, l1_weight, mask))


def image_loss_term(
    image: torch.Tensor,
    target: torch.Tensor,
    l1_weight: float = 0.8,
    mask: torch.Tensor | None = None,
    clip: bool = False,
    mask_sum: float | None = None,
) -> Term:
    """Return ``l1_weight * L1 + (1 - l1_weight) * (1 - SSIM)``, the mean over all pixels and channels.

    image, target: [H, W, 3], colours 0..1; gradients flow to each that requires them.
    l1_weight: 0..1.
    mask: [H, W] weights >= 0 or None; both terms become sum(mask * x) / sum(mask). SSIM windows still read the pixels
    that the mask leaves out. A mask of zeros gives a loss of zero.

    clip: clip image values above 1 to 1, without gradient. Photographs clip, so where one is white, any brighter
    rendering is equally right.
    mask_sum: the mask's sum, if known, which saves a reduction on the GPU.

    SSIM: window of 11 taps, sigma 1.5, zero padding, C1 = 0.01^2, C2 = 0.03^2 (Wang et al. 2004). At equal pixels L1
    passes no gradient. A NaN pixel makes the loss NaN, and the gradient within 10 pixels of it. The result has the same
    bytes for any number of threads.

    Raises TensorError for wrong shapes or dtypes, or a weight outside 0..1.
    Source: method, "Render loss".
    """
    check_tensors(image=(image, "H W 3"), target=(target, "H W 3"), mask=(mask, "? H W"))
    if not 0 <= l1_weight <= 1:
        raise TensorError(f"l1_weight: expected 0..1, got {l1_weight}")
    if not image.requires_grad and target.requires_grad and not clip:
        image, target = target, image  # the loss is symmetric, and the kernel's first gradient is the image's
    return _differentiated(image, target, l1_weight, clip, mask, mask_sum)


def _differentiated(
    image: torch.Tensor,
    target: torch.Tensor,
    l1_weight: float,
    clip: bool,
    mask: torch.Tensor | None,
    mask_sum: float | None,
) -> Term:
    launcher = launcher_for(image)
    of_image, of_target = needs_gradient(image, target)
    v_image = torch.empty(image.shape, device=image.device) if of_image or of_target else None
    v_target = torch.empty(image.shape, device=image.device) if of_target else None
    pair = ImagePair(
        image=plain(image),
        target=plain(target),
        mask=None if mask is None else plain(mask),
        l1_weight=l1_weight,
        clip=clip,
    )
    sums: Total | Sums
    if launcher is None:
        sums = Total(*_image.image_loss(pair, v_image, v_target))
    else:
        sums = ImageKernels(launcher).image_loss(pair, v_image, v_target, mask_sum)
    slopes = [(image, v_image)] * of_image + [(target, v_target)] * of_target
    return Term(sums, tuple(Slope(each, v) for each, v in slopes if v is not None))
