"""Times of the image, harmonics and Adam operations: `python benchmarks/image_loss.py [--size 256] [--splats 20000]`.

Each row is one call with its backward through autograd, as training makes it: median and least of 200 runs, for every
variant that the processor runs. Compared with plain torch (convolutions, float32) for the loss.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable

import numpy as np
import torch
from torch.autograd import grad

from mgsr.data.camera import Camera
from mgsr.native import _adam, _harmonics, _image
from mgsr.ops.adam import FusedAdam
from mgsr.ops.depth_normals import depth_to_normals
from mgsr.ops.harmonics import harmonics_to_rgb
from mgsr.ops.image_loss import image_loss
from mgsr.ops.tv import edge_aware_tv

Case = Callable[[], object]


def milliseconds(case: Case, runs: int) -> str:
    times = []
    for _ in range(runs):
        start = time.perf_counter()
        case()
        times.append((time.perf_counter() - start) * 1e3)
    return f"{statistics.median(times):7.3f} {min(times):7.3f}"


def torch_loss(image: torch.Tensor, target: torch.Tensor, window: torch.Tensor) -> torch.Tensor:
    """The same loss as five convolutions."""

    def blur(x: torch.Tensor) -> torch.Tensor:
        return torch.nn.functional.conv2d(x.permute(2, 0, 1)[None], window, padding=5, groups=3)

    a, b, aa, bb, ab = (blur(x) for x in (image, target, image**2, target**2, image * target))
    ssim = (2 * a * b + 1e-4) * (2 * (ab - a * b) + 9e-4) / ((a**2 + b**2 + 1e-4) * (aa + bb - a**2 - b**2 + 9e-4))
    return 0.8 * (image - target).abs().mean() + 0.2 * (1 - ssim.mean())


def gaussian_window() -> torch.Tensor:
    taps = torch.exp(-((torch.arange(11.0) - 5) ** 2) / 4.5)
    return (torch.outer(taps, taps) / taps.sum() ** 2).expand(3, 1, 11, 11).contiguous()


def image_cases(size: int) -> dict[str, Case]:
    image, target = torch.rand(size, size, 3).requires_grad_(), torch.rand(size, size, 3)
    depth = (2 + 0.1 * torch.rand(size, size)).requires_grad_()
    K = np.array([[1.2 * size, 0, size / 2], [0, 1.2 * size, size / 2], [0, 0, 1.0]])
    camera, v_normals = Camera(K, np.eye(4), size, size), torch.rand(size, size, 3)
    window, mask = gaussian_window(), torch.ones(size, size)
    middle = (size // 4, 3 * size // 4, size // 4, 3 * size // 4)
    both = target.clone().requires_grad_()
    return {
        "L1+SSIM": lambda: grad(image_loss(image, target), image),
        "L1+SSIM, both gradients": lambda: grad(image_loss(image, both), (image, both)),
        "L1+SSIM, masked": lambda: grad(image_loss(image, target, mask=mask), image),
        "L1+SSIM, region of a quarter": lambda: grad(image_loss(image, target, region=middle), image),
        "L1+SSIM, forward only": lambda: image_loss(image.detach(), target),
        "L1+SSIM, plain torch": lambda: grad(torch_loss(image, target, window), image),
        "TV of 3 channels": lambda: grad(edge_aware_tv(image, target), image),
        "TV of depth": lambda: grad(edge_aware_tv(depth, target), depth),
        "depth to normals": lambda: grad(depth_to_normals(depth, camera), depth, v_normals),
    }


def splat_cases(count: int) -> dict[str, Case]:
    coeffs, means = torch.randn(count, 16, 3).requires_grad_(), torch.randn(count, 3).requires_grad_()
    center, v_rgb = torch.tensor([0.0, 0.0, -3.0]), torch.randn(count, 3)
    packed = {"sh": torch.randn(count, 48).requires_grad_(), "rest": torch.randn(count, 11).requires_grad_()}
    optimizer = FusedAdam(packed, {"sh": 1e-3, "rest": 1e-3})
    for tensor in packed.values():
        tensor.grad = torch.randn_like(tensor)
    return {
        "harmonics, degree 3": lambda: grad(harmonics_to_rgb(coeffs, means, center, 3), (coeffs, means), v_rgb),
        "Adam, 59 floats a splat": optimizer.step,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=256, help="pixels a side")
    parser.add_argument("--splats", type=int, default=20000)
    parser.add_argument("--runs", type=int, default=200)
    options = parser.parse_args()
    torch.manual_seed(0)
    cases = image_cases(options.size) | splat_cases(options.splats)
    print(f"{options.size} x {options.size} pixels, {options.splats} splats, {_image.threads()} threads; milliseconds")
    print(f"{'':30}" + "".join(f"{isa + ': median, least':>26}" for isa in _image.isas()))
    for name, case in cases.items():
        row = []
        for isa in _image.isas():
            for family in (_image, _harmonics, _adam):
                family.set_isa(isa)
            row.append(milliseconds(case, options.runs))
        print(f"{name:30}" + "".join(f"{cell:>26}" for cell in row))


if __name__ == "__main__":
    main()
