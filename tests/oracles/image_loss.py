"""L1 and SSIM in plain torch: two-dimensional convolutions with zero padding, float64."""

from __future__ import annotations

import torch
from torch.nn.functional import conv2d


def window() -> torch.Tensor:
    taps = torch.exp(-((torch.arange(11, dtype=torch.float64) - 5) ** 2) / (2 * 1.5**2))
    taps = taps / taps.sum()
    return torch.outer(taps, taps).expand(3, 1, 11, 11).contiguous()


def ssim_map(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """Return the structural similarity [H, W, 3] of two images [H, W, 3] at each pixel."""

    def blur(x: torch.Tensor) -> torch.Tensor:
        return conv2d(x.permute(2, 0, 1)[None], window(), padding=5, groups=3)[0].permute(1, 2, 0)

    mean_a, mean_b = blur(a), blur(b)
    var_a, var_b = blur(a * a) - mean_a**2, blur(b * b) - mean_b**2
    covariance = blur(a * b) - mean_a * mean_b
    luminance = (2 * mean_a * mean_b + 0.01**2) / (mean_a**2 + mean_b**2 + 0.01**2)
    structure = (2 * covariance + 0.03**2) / (var_a + var_b + 0.03**2)
    return luminance * structure


def image_loss(
    a: torch.Tensor, b: torch.Tensor, l1_weight: float = 0.8, mask: torch.Tensor | None = None
) -> torch.Tensor:
    per_pixel = (l1_weight * (a - b).abs() + (1 - l1_weight) * (1 - ssim_map(a, b))).mean(-1)
    if mask is None:
        return per_pixel.mean()
    return (mask * per_pixel).sum() / mask.sum()
