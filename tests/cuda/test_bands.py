"""An image whose pairs of splats and tiles are too many for the memory is worked in bands of rows of tiles."""

from __future__ import annotations

from itertools import pairwise

import pytest
import torch

from mgsr.data.camera import Camera
from mgsr.errors import GpuError
from mgsr.native.cuda import tiles
from mgsr.ops.surfels import SurfelOptions, rasterize_surfels
from mgsr.ops.volumes import Reflected, rasterize_volumes
from tests.cuda.machines import SHIM, Machine, on_each_machine
from tests.ops.splat_scenes import camera, random_splats
from tests.ops.test_volumes import dual_splats

VIEW = camera().resized(120, 84)  # 8 x 6 tiles
KINDS = ("single", "dual", "surfels", "distortion")
IMAGES = ("color", "alpha", "depth", "reflected", "weight", "median_depth", "normal", "distortion")


def render(machine: Machine, kind: str, view: Camera = VIEW) -> tuple[dict[str, torch.Tensor], dict[str, torch.Tensor]]:
    """The images there are, and the gradients of all of them."""
    made = dual_splats(60) if kind == "dual" else random_splats(60, 3 if kind == "single" else 2)
    splats = {name: t.float().to(machine.device).requires_grad_() for name, t in made.items()}
    plain = [splats[name] for name in ("means", "quats", "scales", "opacities", "colors")]
    background = torch.tensor([0.1, 0.5, 0.9], device=machine.device)
    with machine.running():
        if kind == "dual":
            light = Reflected(splats["refl_opacities"], splats["refl_colors"], splats["weights"])
            raster = rasterize_volumes(*plain, view, background, light)
        elif kind == "single":
            raster = rasterize_volumes(*plain, view, background)
        else:
            raster = rasterize_surfels(*plain, view, background, SurfelOptions(distortion=kind == "distortion"))
        images = {name: getattr(raster, name, None) for name in IMAGES}
        images = {name: image for name, image in images.items() if image is not None}
        generator = torch.Generator().manual_seed(0)
        total = [(image.cpu() * torch.rand(image.shape, generator=generator)).sum() for image in images.values()]
        torch.stack(total).sum().backward()
    gradients = {name: t.grad.cpu() for name, t in splats.items() if t.grad is not None}
    return {name: image.detach().cpu() for name, image in images.items()}, gradients


@on_each_machine
@pytest.mark.parametrize("kind", KINDS)
def test_bands_change_no_pixel(machine: Machine, kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    cut, bands = tiles.cut_into_bands, list[tiles.Band]()

    def noted(*arguments) -> list[tiles.Band]:
        bands[:] = cut(*arguments)
        return bands.copy()

    for module in ("volumes", "surfels"):
        monkeypatch.setattr(f"mgsr.native.cuda.{module}.cut_into_bands", noted)
    whole, whole_gradients = render(machine, kind)
    (image,) = bands
    monkeypatch.setattr(tiles, "most_pairs", lambda device: image.pairs // 3)
    banded, banded_gradients = render(machine, kind)
    assert len(bands) > 2 and sum(band.pairs for band in bands) == image.pairs
    assert (bands[0].first, bands[-1].end) == (0, 6)
    assert all(before.end == after.first for before, after in pairwise(bands))
    for name, pixels in whole.items():
        assert torch.equal(pixels, banded[name]), name
    for name, gradient in whole_gradients.items():  # sums of float32 numbers in another order
        assert (gradient - banded_gradients[name]).abs().max() <= 1e-5 * gradient.abs().max(), name


@on_each_machine
def test_a_row_too_full_is_refused_with_the_cure(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tiles, "most_pairs", lambda device: 3)
    with pytest.raises(GpuError, match=r"a row of tiles .* pairs .* is for 3: .*fewer or smaller splats"):
        render(machine, "single")


def test_a_card_is_given_what_half_its_memory_holds(monkeypatch: pytest.MonkeyPatch) -> None:
    class Properties:
        total_memory = 9_000_000

    monkeypatch.setattr(torch.cuda, "get_device_properties", lambda device: Properties)
    tiles.most_pairs.cache_clear()
    assert tiles.most_pairs(torch.device("cuda", 0)) == 10_000
    Properties.total_memory = 2**50
    tiles.most_pairs.cache_clear()
    assert tiles.most_pairs(torch.device("cuda", 0)) == 2**31 - 1
    tiles.most_pairs.cache_clear()
    assert tiles.most_pairs(SHIM.device) == 2**31 - 1
