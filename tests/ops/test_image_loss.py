"""The fused L1 + SSIM loss against convolutions in float64 and against scikit-image."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from skimage.metrics import structural_similarity

from mgsr.errors import TensorError
from mgsr.native import _image
from mgsr.ops.image_loss import image_loss
from tests.ops.variants import ISAS, variant
from tests.optional import present
from tests.oracles import image_loss as oracle

# Variances are differences of float32 means of squares: 1e-7 absolute beside C2 = 9e-4.
LOSS: dict[str, Any] = {"rtol": 1e-5, "atol": 1e-6}


def pictures(height: int, width: int) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(height * 1000 + width)
    target = torch.rand(height, width, 3, generator=generator)
    return (target + 0.2 * torch.randn(height, width, 3, generator=generator)).clamp(0, 1), target


def random_mask(height: int, width: int) -> torch.Tensor:
    mask = (torch.rand(height, width, generator=torch.Generator().manual_seed(5)) > 0.4).float()
    mask[0, 0] = 0.5
    return mask


def gradients(
    function: Callable[..., torch.Tensor], image: torch.Tensor, target: torch.Tensor, *args: Any, **kwargs: Any
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    image, target = image.clone().requires_grad_(), target.clone().requires_grad_()
    loss = function(image, target, *args, **kwargs)
    loss.backward()
    return loss.detach(), present(image.grad), present(target.grad)


def assert_gradients_close(came: torch.Tensor, expected: torch.Tensor) -> None:
    """Check that gradients agree within 1e-5 of the largest.

    float32 rounding grows by E[x^2] / C2 where a window is nearly flat.
    """
    assert (came.double() - expected).abs().max() <= 1e-5 * expected.abs().max()


@pytest.mark.parametrize("isa", ISAS)
@pytest.mark.parametrize("size", [(1, 1), (7, 8), (9, 1), (33, 65), (130, 300)])
@pytest.mark.parametrize("masked", [False, True])
def test_matches_the_oracle(isa: str, size: tuple[int, int], masked: bool) -> None:
    image, target = pictures(*size)
    mask = random_mask(*size) if masked else None
    with variant(_image, isa):
        came = gradients(image_loss, image, target, 0.8, mask)
    mask64 = None if mask is None else mask.double()
    expected = gradients(oracle.image_loss, image.double(), target.double(), 0.8, mask64)
    torch.testing.assert_close(came[0].double(), expected[0], **LOSS)
    assert_gradients_close(came[1], expected[1])
    assert_gradients_close(came[2], expected[2])


def test_ssim_agrees_with_scikit_image() -> None:
    image, target = pictures(40, 50)
    _, ours = structural_similarity(
        image.double().numpy(),
        target.double().numpy(),
        channel_axis=2,
        gaussian_weights=True,
        sigma=1.5,
        use_sample_covariance=False,
        data_range=1.0,
        full=True,
    )
    inner = np.zeros((40, 50), np.float32)
    inner[5:-5, 5:-5] = 1  # the borders differ: scikit-image reflects, we pad with zeros
    loss = image_loss(image, target, 0.0, torch.from_numpy(inner))
    assert abs(1 - float(loss) - ours[5:-5, 5:-5].mean()) < 1e-5


@pytest.mark.parametrize("wants", ["image", "target"])
def test_one_gradient_alone_equals_that_of_both(wants: str) -> None:
    image, target = pictures(33, 65)
    both = gradients(image_loss, image, target)
    leaf = (image if wants == "image" else target).requires_grad_()
    image_loss(image, target).backward()
    assert leaf.grad is not None
    assert_gradients_close(leaf.grad, both[1 if wants == "image" else 2].double())


def test_same_bytes_for_any_thread_count() -> None:
    image, target = pictures(200, 300)
    results = []
    for threads in (1, 2, 5):
        with variant(_image, threads=threads):
            results.append(gradients(image_loss, image, target, 0.8, random_mask(200, 300)))
    for other in results[1:]:
        assert all(torch.equal(a, b) for a, b in zip(results[0], other, strict=True))


@pytest.mark.parametrize("value", [0.0, 0.3, 1.0])
def test_equal_constant_images_cost_nothing(value: float) -> None:
    image = torch.full((33, 65, 3), value)
    loss, v_image, _ = gradients(image_loss, image, image.clone())
    assert abs(float(loss)) < 1e-6
    assert v_image.abs().max() < 1e-7


def test_constant_images_that_differ() -> None:
    image, target = torch.full((33, 65, 3), 0.3), torch.full((33, 65, 3), 0.6)
    came = gradients(image_loss, image, target)
    expected = gradients(oracle.image_loss, image.double(), target.double())
    # A flat window has no variance, so the rounding of E[x^2] (6e-8 beside C2 = 9e-4) is all that is left of it.
    torch.testing.assert_close(came[0].double(), expected[0], rtol=1e-4, atol=0)
    assert (came[1].double() - expected[1]).abs().max() <= 1e-4 * expected[1].abs().max()


def test_an_empty_mask_gives_zero() -> None:
    image, target = pictures(9, 9)
    loss, v_image, _ = gradients(image_loss, image, target, 0.8, torch.zeros(9, 9))
    assert float(loss) == 0
    assert not v_image.any()


def test_nan_reaches_the_loss_and_ten_pixels() -> None:
    image, target = pictures(40, 40)
    image[0, 0, 0] = torch.nan
    loss, v_image, _ = gradients(image_loss, image, target)
    assert torch.isnan(loss)
    assert torch.isnan(v_image[0, 0, 0])
    assert torch.isfinite(v_image[11:]).all()
    assert torch.isfinite(v_image[..., 1:]).all()


def test_backward_scales_by_the_incoming_gradient() -> None:
    image, target = pictures(9, 17)
    once = gradients(image_loss, image, target)[1]
    twice = gradients(lambda a, b: 2.5 * image_loss(a, b), image, target)[1]
    torch.testing.assert_close(twice, 2.5 * once)


def test_bad_arguments_are_named() -> None:
    image, target = pictures(9, 9)
    with pytest.raises(TensorError, match="target"):
        image_loss(image, target[:8])
    with pytest.raises(TensorError, match="mask"):
        image_loss(image, target, mask=torch.ones(9, 8))
    with pytest.raises(TensorError, match="l1_weight"):
        image_loss(image, target, 1.5)
