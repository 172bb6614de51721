"""The surfel rasterizer against a brute-force float64 renderer, forward and every gradient."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from mgsr.data.camera import Camera
from mgsr.errors import TensorError
from mgsr.native import _surfels
from mgsr.ops.surfels import SurfelOptions, rasterize_surfels
from tests.ops.splat_scenes import camera, random_splats, splat_arguments
from tests.ops.variants import variant
from tests.oracles import surfels as oracle

Tensors = dict[str, torch.Tensor]
Rendered = tuple[Tensors, Tensors, Any]  # images, gradients, what the renderer returned

BACKGROUND = torch.tensor([0.2, 0.5, 0.9])
IMAGES = ("color", "alpha", "depth", "median_depth", "normal", "distortion")
SPLATS = ("means", "quats", "scales", "opacities", "colors")
# float32 rounding through a sum of ~100 layers; a splat that crosses the 1/255 threshold would show as 4e-3. Seen from
# the side a splat's weight changes by its own size over a small part of a pixel: more digits go there.
TOLERANCE = {"images": 2e-5, "gradients": 3e-4}
STEEP = {"images": 1e-4, "gradients": 5e-3}
# Of a sine of 1e-3 float32 holds three digits less than of 1: so much the offset from a thin splat's middle has.
NEARLY_EDGE_ON = {"images": 3e-4, "gradients": 1e-3}
OPTIONS = SurfelOptions(near=0.2, far=5.0, distortion=True)


def run(
    renderer: Callable[..., Any],
    splats: dict[str, torch.Tensor],
    view: Camera,
    dtype: torch.dtype,
    options: SurfelOptions = OPTIONS,
    images: tuple[str, ...] = IMAGES,
) -> Rendered:
    """Render, differentiate a fixed random combination of the named images, and return images, gradients and stats."""
    leaves = {k: v.to(dtype).clone().requires_grad_() for k, v in splats.items()}
    background = BACKGROUND.to(dtype).clone().requires_grad_()
    out = renderer(*(leaves[k] for k in SPLATS), view, background, options)
    g = torch.Generator().manual_seed(5)
    loss = torch.zeros((), dtype=dtype)
    rendered: Tensors = {}
    for name in IMAGES:
        image = getattr(out, name)
        if image is None:
            continue
        rendered[name] = image.detach().double()
        weights = torch.randn(image.shape, generator=g, dtype=torch.float64).to(dtype)
        if name in images:
            loss = loss + (image * weights).sum()
    loss.backward()
    gradients = {k: v.grad.double() for k, v in leaves.items() if v.grad is not None}
    if background.grad is not None:
        gradients["background"] = background.grad.double()
    return rendered, gradients, out


@dataclass
class Shifted(oracle.SurfelImages):
    """The oracle's images; the gradient of shift [N,2] is that of the projected centres."""

    shift: torch.Tensor


def brute_force(
    means: torch.Tensor,
    quats: torch.Tensor,
    scales: torch.Tensor,
    opacities: torch.Tensor,
    colors: torch.Tensor,
    view: Camera,
    background: torch.Tensor,
    options: SurfelOptions,
) -> Shifted:
    K, pose = torch.tensor(view.K), torch.tensor(view.cam_from_world)
    shift = torch.zeros(len(means), 2, dtype=torch.float64, requires_grad=True)
    splats = (means, quats, scales, opacities, colors)
    out = oracle.render(
        *splats, K, pose, view.width, view.height, background, near=options.near, far=options.far, shift=shift
    )
    return Shifted(**vars(out), shift=shift)


def assert_close(ours: dict[str, torch.Tensor], theirs: dict[str, torch.Tensor], tolerance: float) -> None:
    for name, expected in theirs.items():
        error = (ours[name] - expected).abs().max() / expected.abs().max().clamp(min=1.0)
        assert error < tolerance, f"{name}: largest error {error:.2e} of its largest value"


def compare(
    splats: dict[str, torch.Tensor],
    view: Camera,
    tolerance: dict[str, float] = TOLERANCE,
    options: SurfelOptions = OPTIONS,
    images: tuple[str, ...] = IMAGES,
) -> Rendered:
    expected = run(brute_force, splats, view, torch.float64, options, images)
    got = run(rasterize_surfels, {k: v.float() for k, v in splats.items()}, view, torch.float32, options, images)
    assert_close(got[0], expected[0], tolerance["images"])
    assert_close(got[1], expected[1], tolerance["gradients"])
    v_means2d = {"v_means2d": got[2].stats.v_means2d.double()}
    assert_close(v_means2d, {"v_means2d": expected[2].shift.grad}, tolerance["gradients"])
    return got


def edge_on_splats(count: int, sine: float) -> dict[str, torch.Tensor]:
    """Draw splats whose planes the rays through their centres meet under (about) the given sine."""
    splats = random_splats(count, 2, seed=11)
    view = camera()
    rays = torch.nn.functional.normalize(splats["means"] - torch.tensor(view.center), dim=1)
    tangent = torch.nn.functional.normalize(torch.linalg.cross(rays, splats["quats"][:, 1:]), dim=1)
    normal = sine * rays + (1 - sine**2) ** 0.5 * torch.linalg.cross(rays, tangent)
    columns = torch.stack([tangent, torch.linalg.cross(normal, tangent), normal], -1)
    w = 0.5 * (1 + columns.diagonal(dim1=1, dim2=2).sum(1)).clamp(min=1e-6).sqrt()
    axis = torch.stack([columns[:, i, j] - columns[:, j, i] for i, j in ((2, 1), (0, 2), (1, 0))], -1)
    splats["quats"] = torch.cat([w[:, None], axis / (4 * w[:, None])], 1)
    return {name: tensor.float().double() for name, tensor in splats.items()}


def held_camera() -> Camera:
    """Return `camera` in numbers that float32 holds.

    To round them changes what is seen from the side by a thousandth.
    """
    view = camera()
    K, pose = (numbers.astype(np.float32).astype(float) for numbers in (view.K, view.cam_from_world))
    return Camera(K, pose, view.width, view.height)


def slanted_part(path: Path, side: int) -> tuple[dict[str, torch.Tensor], Camera]:
    """Return the splats of a raster scene that are seen nearly from the side, and a camera for the image's middle."""
    data = np.load(path)
    names = ("means", "quats", "scales", "opacities", "rgb")
    splats = dict(zip(SPLATS, (torch.tensor(data[name]).double() for name in names), strict=True))
    splats["scales"] = splats["scales"][:, :2]
    K, pose = data["K"].astype(float), data["viewmat"].astype(float)
    K[:2, 2] -= (np.array([int(data["width"]), int(data["height"])]) - side) / 2
    local = splats["means"] @ torch.tensor(pose[:3, :3]).T + torch.tensor(pose[:3, 3])
    normals = oracle.rotation_matrices(splats["quats"])[:, :, 2] @ torch.tensor(pose[:3, :3]).T
    sines = (torch.nn.functional.normalize(local, dim=1) * normals).sum(1).abs()
    pixels = local[:, :2] / local[:, 2:] * torch.tensor(K.diagonal()[:2]) + torch.tensor(K[:2, 2])
    near = ((pixels > -8) & (pixels < side + 8)).all(1) & (local[:, 2] > 0.2)
    chosen = near & (sines > 1.01e-3) & (sines < 0.05)
    return {name: tensor[chosen] for name, tensor in splats.items()}, Camera(K, pose, side, side)


@pytest.mark.parametrize("isa", _surfels.isas())
def test_matches_brute_force(isa: str) -> None:
    with variant(_surfels, isa):
        compare(random_splats(60, 2, seed=20), camera())


@pytest.mark.parametrize("name", IMAGES)
def test_each_image_alone_sends_its_gradient(name: str) -> None:
    compare(random_splats(60, 2, seed=1), camera(), images=(name,))


def test_without_distortion() -> None:
    splats = random_splats(60, 2, seed=2)
    images, gradients, out = run(
        rasterize_surfels, {k: v.float() for k, v in splats.items()}, camera(), torch.float32, images=IMAGES[:5]
    )
    plain = run(
        rasterize_surfels,
        {k: v.float() for k, v in splats.items()},
        camera(),
        torch.float32,
        replace(OPTIONS, distortion=False),
    )
    assert out.distortion is not None and plain[2].distortion is None
    assert all(torch.equal(plain[0][k], images[k]) for k in plain[0])
    assert_close(plain[1], gradients, 1e-6)


@pytest.mark.parametrize("size", [0.01, 0.03, 0.5, 2.0])
def test_small_splats_and_large(size: float) -> None:
    """Check splats under a pixel, whose weight the low-pass gives, and large disks.

    The disks cross the image's border, and their planes slant.
    """
    compare(random_splats(40, 2, seed=3, size=size), camera(), STEEP if size > 1 else TOLERANCE)


@pytest.mark.parametrize("isa", _surfels.isas())
@pytest.mark.parametrize("sine", [1e-4, 5e-4, 1.1e-3, 2e-3, 0.01, 0.1])
def test_edge_on(isa: str, sine: float) -> None:
    with variant(_surfels, isa):
        compare(edge_on_splats(40, sine), held_camera(), NEARLY_EDGE_ON)


@pytest.mark.parametrize("isa", _surfels.isas())
def test_the_slanted_splats_of_a_large_scene(shared_data: Path, isa: str) -> None:
    """Check the slanted splats of 20,000, seen under a sine of 1e-3 to 0.05, to which the largest gradients belong.

    They are checked by the middle of the image, which is as much as the oracle has memory for.
    """
    splats, view = slanted_part(shared_data / "raster" / "s20k_256.npz", side=96)
    assert len(splats["means"]) > 50
    with variant(_surfels, isa):
        compare(splats, view, NEARLY_EDGE_ON, SurfelOptions(distortion=True))


def test_disks_that_reach_behind_the_camera() -> None:
    splats = random_splats(12, 2, seed=7, size=3.0)
    splats["means"][:, 2] -= 1.2
    compare(splats, camera(), STEEP)


def test_near_the_border() -> None:
    splats = random_splats(60, 2, seed=8, size=0.3)
    splats["means"][:, 0] += torch.where(torch.arange(60) % 2 == 0, 0.8, -0.8)
    compare(splats, camera())


@pytest.mark.parametrize("width,height", [(1, 1), (7, 9), (8, 8), (9, 17)])
def test_image_sizes_around_the_tile(width: int, height: int) -> None:
    compare(random_splats(30, 2, seed=3, size=0.5), camera(width, height, off_center=False))


@pytest.mark.parametrize("isa", _surfels.isas())
def test_splats_across_many_tiles(isa: str) -> None:
    """Check wide and thin splats over 10 x 6 tiles, some of which reach far outside."""
    splats = random_splats(40, 2, seed=12)
    splats["scales"] *= torch.tensor([6.0, 1.0], dtype=torch.float64)
    with variant(_surfels, isa):
        compare(splats, camera(150, 90), STEEP)


@pytest.mark.parametrize("isa", _surfels.isas())
def test_more_splats_than_a_chunk(isa: str) -> None:
    """Check more splats than a chunk: both they and their depth order are cut into chunks.

    A third of the splats is culled in between.
    """
    splats = random_splats(2500, 2, seed=13, size=0.03)
    splats["means"][::3, 2] -= 10
    with variant(_surfels, isa):
        compare(splats, camera())


def test_one_splat_facing_the_camera() -> None:
    view = Camera(np.array([[50.0, 0, 16], [0, 50, 16], [0, 0, 1]]), np.eye(4), 32, 32)
    splats = {k: v[:1].clone() for k, v in random_splats(1, 2).items()}
    splats["means"][:] = torch.tensor([0.02, 0.02, 2.0])
    splats["quats"][:] = torch.tensor([1.0, 0, 0, 0])
    splats["scales"][:] = 0.2
    splats["opacities"][:] = 0.8
    images, _, out = compare(splats, view)
    alpha = images["alpha"][16, 16]
    assert alpha == pytest.approx(0.8, abs=1e-6)
    assert torch.allclose(images["normal"][16, 16], alpha * torch.tensor([0.0, 0, -1], dtype=torch.float64))
    assert images["depth"][16, 16] == pytest.approx(2.0, abs=1e-5)
    assert images["median_depth"][16, 16] == pytest.approx(2.0, abs=1e-5)
    assert out.stats.visible.all()


def test_stacked_opaque_layers_stop_and_stay_finite() -> None:
    splats = random_splats(50, 2, seed=4, size=2.0)
    splats["opacities"][:] = 1.0
    expected = run(brute_force, splats, camera(), torch.float64)
    got = run(rasterize_surfels, {k: v.float() for k, v in splats.items()}, camera(), torch.float32)
    assert_close(got[0], expected[0], TOLERANCE["images"])
    assert all(torch.isfinite(v).all() for v in got[1].values())


def test_same_bytes_for_any_thread_count() -> None:
    splats = {k: v.float() for k, v in random_splats(3000, 2).items()}
    results = []
    for threads in (1, 2, 3):
        with variant(_surfels, threads=threads):
            results.append(run(rasterize_surfels, splats, camera(200, 150), torch.float32))
    for images, gradients, out in results[1:]:
        assert all(torch.equal(images[k], results[0][0][k]) for k in images)
        assert all(torch.equal(gradients[k], results[0][1][k]) for k in gradients)
        assert torch.equal(out.stats.v_means2d, results[0][2].stats.v_means2d)


@pytest.mark.parametrize("field", SPLATS)
@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_a_non_finite_splat_is_left_out(field: str, bad: float) -> None:
    splats = {k: v.float() for k, v in random_splats(20, 2).items()}
    without = {k: torch.cat([v[:7], v[8:]]) for k, v in splats.items()}
    expected = run(rasterize_surfels, without, camera(), torch.float32)
    splats[field].view(20, -1)[7, 0] = bad
    got = run(rasterize_surfels, splats, camera(), torch.float32)
    assert all(torch.equal(got[0][k], expected[0][k]) for k in got[0])
    for name in SPLATS:
        assert torch.equal(torch.cat([got[1][name][:7], got[1][name][8:]]), expected[1][name])
        assert not got[1][name][7].any()
    assert not got[2].stats.visible[7]


def test_nothing_to_see() -> None:
    view = camera()
    empty = {k: v[:0].float() for k, v in random_splats(1, 2).items()}
    behind = {k: v.float() for k, v in random_splats(5, 2).items()}
    behind["means"][:, 2] -= 10
    for splats in (empty, behind):
        images, gradients, out = run(rasterize_surfels, splats, view, torch.float32)
        assert torch.equal(images["color"], BACKGROUND.double().expand(view.height, view.width, 3))
        assert all(not images[k].any() for k in IMAGES[1:])
        assert all(not gradients[k].any() for k in SPLATS)
        assert not out.stats.visible.any()


def test_wrong_arguments_are_named() -> None:
    s = {k: v.float() for k, v in random_splats(5, 2).items()}
    with pytest.raises(TensorError, match=r"scales: expected \[N=5, 2\], got \[5, 1\]"):
        rasterize_surfels(s["means"], s["quats"], s["scales"][:, :1], s["opacities"], s["colors"], camera(), BACKGROUND)
    with pytest.raises(TensorError, match="near < far"):
        rasterize_surfels(
            *splat_arguments(s[k] for k in SPLATS), camera(), BACKGROUND, SurfelOptions(near=2.0, far=1.0)
        )
