"""The 3D rasterizer against a brute-force float64 renderer, forward and every gradient."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from mgsr.data.camera import Camera
from mgsr.errors import TensorError
from mgsr.native import _gaussians
from mgsr.ops.gaussians import GaussianOptions, GaussianRaster, Reflected, rasterize_gaussians
from tests.ops.splat_scenes import camera, random_splats, splat_arguments
from tests.ops.variants import variant
from tests.oracles import gaussians as oracle

Tensors = dict[str, torch.Tensor]
Rendered = tuple[Tensors, Tensors]  # images, gradients
Light = tuple[torch.Tensor, ...]  # opacities, colors, weights

BACKGROUND = torch.tensor([0.2, 0.5, 0.9])
# float32 rounding through a sum of ~100 layers; a splat that crosses the 1/255 threshold would show as 4e-3.
TOLERANCE = {"images": 2e-5, "gradients": 2e-4}


def dual_splats(count: int, seed: int = 0) -> dict[str, torch.Tensor]:
    splats = random_splats(count, 3, seed)
    extra = random_splats(count, 3, seed + 1000)
    reflected = {"refl_opacities": extra["opacities"], "refl_colors": extra["colors"]}
    return splats | reflected | {"weights": extra["scales"][:, 0]}


def run(
    renderer: Callable[..., Any],
    splats: dict[str, torch.Tensor],
    view: Camera,
    dtype: torch.dtype,
    dual: bool,
    compensate: bool = False,
) -> Rendered:
    """Render and differentiate a fixed random combination of all output images."""
    leaves = {k: v.to(dtype).clone().requires_grad_() for k, v in splats.items()}
    names = ("means", "quats", "scales", "opacities", "colors")
    reflected = tuple(leaves[k] for k in ("refl_opacities", "refl_colors", "weights")) if dual else None
    out = renderer(*(leaves[k] for k in names), view, BACKGROUND.to(dtype), reflected, compensate)
    g = torch.Generator().manual_seed(5)
    loss = torch.zeros((), dtype=dtype)
    images: Tensors = {}
    for name in ("color", "alpha", "depth", "reflected", "weight"):
        image = getattr(out, name)
        if image is None:
            continue
        images[name] = image.detach().double()
        loss = loss + (image * torch.randn(image.shape, generator=g, dtype=torch.float64).to(dtype)).sum()
    loss.backward()
    return images, {k: v.grad.double() for k, v in leaves.items() if v.grad is not None}


def native(
    means: torch.Tensor,
    quats: torch.Tensor,
    scales: torch.Tensor,
    opacities: torch.Tensor,
    colors: torch.Tensor,
    view: Camera,
    background: torch.Tensor,
    reflected: Light | None,
    compensate: bool,
) -> GaussianRaster:
    refl = Reflected(*reflected) if reflected else None
    options = GaussianOptions(compensate=compensate)
    return rasterize_gaussians(means, quats, scales, opacities, colors, view, background, refl, options)


def brute_force(
    means: torch.Tensor,
    quats: torch.Tensor,
    scales: torch.Tensor,
    opacities: torch.Tensor,
    colors: torch.Tensor,
    view: Camera,
    background: torch.Tensor,
    reflected: Light | None,
    compensate: bool,
) -> oracle.Images:
    return oracle.render(means, quats, scales, opacities, colors, view, background, reflected, compensate=compensate)


def assert_close(ours: dict[str, torch.Tensor], theirs: dict[str, torch.Tensor], tolerance: float) -> None:
    for name, expected in theirs.items():
        error = (ours[name] - expected).abs().max() / expected.abs().max().clamp(min=1.0)
        assert error < tolerance, f"{name}: largest error {error:.2e} of its largest value"


@pytest.fixture(params=_gaussians.isas())
def isa(request: pytest.FixtureRequest) -> Iterator[str]:
    with variant(_gaussians, request.param):
        yield request.param


@pytest.mark.parametrize("dual", [False, True], ids=["single", "dual"])
@pytest.mark.parametrize("compensate", [False, True], ids=["plain", "compensated"])
def test_matches_brute_force(isa: str, dual: bool, compensate: bool) -> None:
    splats = dual_splats(60) if dual else random_splats(60, 3)
    expected = run(brute_force, splats, camera(), torch.float64, dual, compensate)
    got = run(native, {k: v.float() for k, v in splats.items()}, camera(), torch.float32, dual, compensate)
    assert_close(got[0], expected[0], TOLERANCE["images"])
    assert_close(got[1], expected[1], TOLERANCE["gradients"])


@pytest.mark.parametrize("width,height", [(1, 1), (7, 9), (8, 8), (9, 17)])
def test_image_sizes_around_the_tile(width: int, height: int) -> None:
    splats = random_splats(30, 3, seed=3, size=0.5)
    view = camera(width, height, off_center=False)
    expected = run(brute_force, splats, view, torch.float64, False)
    got = run(native, splats, view, torch.float32, False)
    assert_close(got[0], expected[0], TOLERANCE["images"])
    assert_close(got[1], expected[1], TOLERANCE["gradients"])


def test_splats_across_many_tiles(isa: str) -> None:
    """Check wide and thin splats over 10 x 6 tiles, some of which reach far outside."""
    splats = dual_splats(40, seed=7)
    splats["scales"] *= torch.tensor([8.0, 1.0, 2.0], dtype=torch.float64)
    view = camera(150, 90)
    expected = run(brute_force, splats, view, torch.float64, True)
    got = run(native, splats, view, torch.float32, True)
    assert_close(got[0], expected[0], TOLERANCE["images"])
    assert_close(got[1], expected[1], TOLERANCE["gradients"])


def test_more_splats_than_a_chunk(isa: str) -> None:
    """Check more splats than a chunk: both they and their depth order are cut into chunks.

    A third of the splats is culled in between.
    """
    splats = dual_splats(2500, seed=9)
    splats["scales"] *= 0.2
    splats["means"][::3, 2] -= 10
    expected = run(brute_force, splats, camera(), torch.float64, True)
    got = run(native, splats, camera(), torch.float32, True)
    assert_close(got[0], expected[0], TOLERANCE["images"])
    assert_close(got[1], expected[1], TOLERANCE["gradients"])


def test_stacked_opaque_layers_stop_and_stay_finite() -> None:
    splats = random_splats(50, 3, seed=4, size=2.0)
    splats["opacities"][:] = 1.0
    expected = run(brute_force, splats, camera(), torch.float64, False)
    got = run(native, splats, camera(), torch.float32, False)
    assert_close(got[0], expected[0], TOLERANCE["images"])
    assert all(torch.isfinite(v).all() for v in got[1].values())


def test_same_bytes_for_any_thread_count() -> None:
    splats = {k: v.float() for k, v in dual_splats(3000).items()}
    results = []
    for threads in (1, 2, 3):
        with variant(_gaussians, threads=threads):
            results.append(run(native, splats, camera(200, 150), torch.float32, True))
    for images, gradients in results[1:]:
        assert all(torch.equal(images[k], results[0][0][k]) for k in images)
        assert all(torch.equal(gradients[k], results[0][1][k]) for k in gradients)


def test_equal_depths_blend_by_index() -> None:
    splats = random_splats(8, 3, seed=6)
    splats["means"][:] = torch.tensor([0.0, 0.0, 0.1], dtype=torch.float64)
    expected = run(brute_force, splats, camera(), torch.float64, False)
    got = run(native, splats, camera(), torch.float32, False)
    assert_close(got[0], expected[0], TOLERANCE["images"])


@pytest.mark.parametrize("field", ["means", "quats", "scales", "opacities", "colors"])
@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_a_non_finite_splat_is_left_out(field: str, bad: float) -> None:
    splats = random_splats(20, 3)
    without = {k: torch.cat([v[:7], v[8:]]) for k, v in splats.items()}
    expected, expected_grads = run(native, without, camera(), torch.float32, False)
    splats[field].view(20, -1)[7, 0] = bad
    got, grads = run(native, splats, camera(), torch.float32, False)
    assert all(torch.equal(got[k], expected[k]) for k in got)
    assert torch.equal(torch.cat([grads["means"][:7], grads["means"][8:]]), expected_grads["means"])


def test_nothing_to_see() -> None:
    view = camera()
    empty = {k: v[:0] for k, v in random_splats(1, 3).items()}
    behind = random_splats(5, 3)
    behind["means"][:, 2] -= 10
    for splats in (empty, behind):
        images, gradients = run(native, splats, view, torch.float32, False)
        assert torch.equal(images["color"], BACKGROUND.double().expand(view.height, view.width, 3))
        assert not images["alpha"].any() and not images["depth"].any()
        assert all(not v.any() for v in gradients.values())


def test_wrong_shape_is_named() -> None:
    s = {k: v.float() for k, v in random_splats(5, 3).items()}
    with pytest.raises(TensorError, match=r"quats: expected \[N=5, 4\], got \[5, 3\]"):
        rasterize_gaussians(
            s["means"], s["quats"][:, :3], s["scales"], s["opacities"], s["colors"], camera(), BACKGROUND
        )


@pytest.mark.parametrize("name", ["s5k_128", "s20k_256"])
def test_matches_reference_images(shared_data: Path, name: str) -> None:
    z, ref = np.load(shared_data / "raster" / f"{name}.npz"), np.load(shared_data / "raster" / f"ref_{name}.npz")
    leaves = [torch.tensor(z[k]).requires_grad_() for k in ("means", "quats", "scales", "opacities", "rgb")]
    view = Camera(z["K"].astype(float), z["viewmat"].astype(float), int(z["width"]), int(z["height"]))
    out = rasterize_gaussians(*splat_arguments(leaves), view, torch.tensor(z["background"]))
    assert np.abs(out.color.detach().numpy() - ref["img"]).max() < 1e-3
    if name != "s5k_128":
        return
    (out.color * torch.tensor(z["grad_image"])).sum().backward()
    grads = np.load(shared_data / "raster" / "grad_ref_s5k_128.npz")
    for leaf, key in zip(leaves, ("means", "quats", "scales", "opacities", "rgb"), strict=True):
        expected = grads[key]
        assert leaf.grad is not None
        assert np.abs(leaf.grad.numpy() - expected).max() < 1e-3 * np.abs(expected).max(), key
