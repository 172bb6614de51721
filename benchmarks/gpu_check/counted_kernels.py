"""Run single kernels inside the range that ncu watches: forward and backward of both branches, and the image loss.

ncu --profile-from-start off python -m benchmarks.gpu_check.counted_kernels ...
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from benchmarks.gpu_check.arguments import parser, require_gpu
from benchmarks.rasterizers import make_scene, our_modes
from mgsr.ops.image_loss import image_loss

SIZE = "100k/800"
SMALL = "1k/64"
MODES = ("dual", "2d")
WARM_UPS = 2


def main() -> None:
    args = parser(__doc__).parse_args()
    require_gpu(args.device)
    device = torch.device(args.device)
    work = rounds(SIZE if device.type == "cuda" else SMALL, device)
    for _ in range(WARM_UPS):
        work()
    if device.type != "cuda":
        return
    torch.cuda.synchronize()
    torch.cuda.profiler.start()
    work()
    torch.cuda.synchronize()
    torch.cuda.profiler.stop()


def rounds(size: str, device: torch.device) -> Callable[[], None]:
    """Return a function that launches each of the kernels once."""
    scene = make_scene(size, device)
    modes = our_modes(scene)
    height, width = scene.camera.height, scene.camera.width
    target = torch.rand(height, width, 3, generator=torch.Generator().manual_seed(1)).to(device)

    def render(mode: str) -> list[Tensor]:
        images = modes[mode]()
        torch.autograd.backward(images, [torch.ones_like(image) for image in images])
        return images

    def work() -> None:
        first, _ = (render(mode) for mode in MODES)
        image_loss(first[0].detach().requires_grad_(), target).backward()

    return work


if __name__ == "__main__":
    main()
