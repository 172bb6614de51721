"""Time and error of every kernel in every variant.

    python -m benchmarks.kernels ../shared/data/raster [--scene s20k_256] [--keep benchmarks/results]

Each row is one kernel through autograd as training calls it: medians of 20 runs, and its largest and mean error to
float64. The oracles of tests/oracles are the witnesses; rasterizers are timed on a scene of the raster folder and
compared on a small one, which brute force can do, the 3D image also with the scene's float64 reference. Variants of a
kernel alternate, so that their ratio holds even where the times drift; run it on a machine that is otherwise idle.
`torch` is the plain float32 computation where there is one: how large float32's own error is. With --keep the rows
take the place of those of the same kernel, variant and size in kernels.csv.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from benchmarks.evidence.kernels import KERNELS, KernelRow, kernel_table, read_kernels, write_kernels
from mgsr.bench.machine import processor_name, program_commit
from mgsr.data.camera import Camera
from mgsr.native import _image, runtime
from mgsr.ops.adam import FusedAdam
from mgsr.ops.depth_normals import depth_to_normals
from mgsr.ops.environment_map import look_up_environment_map
from mgsr.ops.gaussians import GaussianOptions, Reflected, rasterize_gaussians
from mgsr.ops.harmonics import harmonics_to_rgb
from mgsr.ops.image_loss import image_loss
from mgsr.ops.surfels import SurfelOptions, rasterize_surfels
from mgsr.ops.tv import edge_aware_tv
from tests.ops.splat_scenes import camera as small_camera
from tests.ops.splat_scenes import random_splats
from tests.oracles import adam as adam_oracle
from tests.oracles import depth_normals as normals_oracle
from tests.oracles import environment_map as environment_map_oracle
from tests.oracles import gaussians as gaussians_oracle
from tests.oracles import harmonics as harmonics_oracle
from tests.oracles import image_loss as loss_oracle
from tests.oracles import surfels as surfels_oracle
from tests.oracles import tv as tv_oracle

Compute = Callable[..., list[Tensor]]
ADAM_STEPS, ADAM_RATE = 10, 1e-3
SURFACE = ("color", "alpha", "depth", "median_depth", "normal")
SURFEL_MODES = {"2D, colour": ("color",), "2D, surface": SURFACE, "2D, distortion": (*SURFACE, "distortion")}
SMALL = "oracle, 300 splats on 40 x 28"


@dataclass(frozen=True)
class Problem:
    """A problem: inputs, of which the first `leaves` get gradients, and what computes outputs from them."""

    inputs: tuple[Tensor, ...]
    compute: Compute
    leaves: int

    def on(self, device: str, dtype: torch.dtype) -> tuple[Tensor, ...]:
        """Return fresh inputs, of float32's values in every precision; the first `leaves` ask for gradients."""
        moved = [t.detach().float().to(device, dtype) for t in self.inputs]
        return tuple(t.clone().requires_grad_() if i < self.leaves else t for i, t in enumerate(moved))


@dataclass(frozen=True)
class Case:
    """A kernel: what is timed, and what is compared with its oracle, which takes float64 inputs.

    reference: outputs of the timed problem in float64, where they are known. plain: the same in plain float32 torch.
    """

    name: str
    size: str
    timed: Problem
    compared: Problem
    oracle: Compute
    witness: str
    reference: list[Tensor] = field(default_factory=list)
    plain: Compute | None = None


class Errors(NamedTuple):
    """The errors of a kernel, as in KernelRow."""

    error_max: float
    error_mean: float
    gradient_max: float | None
    gradient_mean: float | None


class Times(NamedTuple):
    """The times of one run, milliseconds."""

    forward: float
    backward: float | None
    cpu: float


def raster_cases(path: Path) -> list[Case]:
    """Return the cases of both rasterizers in the modes that training uses, on one file of the raster folder."""
    data = np.load(path)
    means, quats, scales, opacities, colors = (
        torch.tensor(data[key]) for key in ("means", "quats", "scales", "opacities", "rgb")
    )
    view = Camera(data["K"].astype(float), data["viewmat"].astype(float), int(data["width"]), int(data["height"]))
    background = torch.tensor(data["background"])
    light = (opacities, colors, opacities)
    single = Problem((means, quats, scales, opacities, colors, background), gaussians_of(view), 5)
    dual = Problem((means, quats, scales, opacities, colors, *light, background), gaussians_of(view), 8)
    found = path.with_name(f"ref_{path.name}")
    reference = [torch.tensor(np.load(found)["img"])] if found.is_file() else []
    summary = f"image: reference of {path.stem}; gradients: {SMALL}" if reference else SMALL
    small_view, small = small_camera(), random_splats(300, 3)
    small_inputs = tuple(small.values())
    small_light = (small["opacities"].flip(0), small["colors"].flip(0), small["opacities"])
    black = torch.zeros(3, dtype=torch.float64)
    one, both = (
        Problem((*small_inputs, *extra, black), gaussians_of(small_view), 5 + len(extra)) for extra in ((), small_light)
    )
    oracle = gaussians_oracle_of(small_view)
    cases = [
        Case("3D, one colour", path.stem, single, one, oracle, summary, reference),
        Case("3D, both lights", path.stem, dual, both, oracle, SMALL),
    ]
    flat = (means, quats, scales[:, :2].contiguous(), opacities, colors, background)
    small_flat = (*random_splats(300, 2).values(), black)
    for name, images in SURFEL_MODES.items():
        timed = Problem(flat, surfels_of(view, images), 5)
        compared = Problem(small_flat, surfels_of(small_view, images), 5)
        cases.append(Case(name, path.stem, timed, compared, surfels_oracle_of(small_view, images), SMALL))
    return cases


def gaussians_of(view: Camera) -> Compute:
    """Return a function that renders Gaussians: colour alone from five inputs and a background.

    With a reflected light of three more inputs, it returns every output.
    """

    def compute(*inputs: Tensor) -> list[Tensor]:
        means, quats, scales, opacities, colors, *light, background = inputs
        if not light:
            options = GaussianOptions(depth=False)
            return [rasterize_gaussians(means, quats, scales, opacities, colors, view, background, None, options).color]
        out = rasterize_gaussians(means, quats, scales, opacities, colors, view, background, Reflected(*light))
        assert out.depth is not None and out.reflected is not None and out.weight is not None
        return [out.color, out.depth, out.reflected, out.weight]

    return compute


def gaussians_oracle_of(view: Camera) -> Compute:
    def compute(*inputs: Tensor) -> list[Tensor]:
        means, quats, scales, opacities, colors, *light, background = inputs
        out = gaussians_oracle.render(means, quats, scales, opacities, colors, view, background, light or None)
        if not light:
            return [out.color]
        assert out.depth is not None and out.reflected is not None and out.weight is not None
        return [out.color, out.depth, out.reflected, out.weight]

    return compute


def surfels_of(view: Camera, images: tuple[str, ...]) -> Compute:
    options = SurfelOptions(distortion="distortion" in images)

    def compute(*inputs: Tensor) -> list[Tensor]:
        means, quats, scales, opacities, colors, background = inputs
        out = rasterize_surfels(means, quats, scales, opacities, colors, view, background, options)
        return [getattr(out, image) for image in images]

    return compute


def surfels_oracle_of(view: Camera, images: tuple[str, ...]) -> Compute:
    K, pose = torch.tensor(view.K), torch.tensor(view.cam_from_world)

    def compute(*inputs: Tensor) -> list[Tensor]:
        means, quats, scales, opacities, colors, background = inputs
        size = (view.width, view.height)
        out = surfels_oracle.render(means, quats, scales, opacities, colors, K, pose, *size, background)
        return [getattr(out, image) for image in images]

    return compute


def image_cases(side: int) -> list[Case]:
    """Return the cases of losses and normals, on square images of noise, and a smooth depth with noise on it."""
    first, second = torch.rand(side, side, 3), torch.rand(side, side, 3)
    depth = 2 + torch.linspace(0, 0.5, side)[:, None] + 0.01 * torch.rand(side, side)
    K, pose = np.array([[1.2 * side, 0, side / 2], [0, 1.2 * side, side / 2], [0, 0, 1.0]]), np.eye(4)
    view, text = Camera(K, pose, side, side), f"{side} x {side}"

    def normals(depth: Tensor) -> list[Tensor]:
        return [normals_oracle.depth_to_normals(depth, torch.tensor(K).to(depth), torch.tensor(pose).to(depth))]

    return [
        _same("L1 + SSIM", text, (first, second), 1, lambda a, b: [image_loss(a, b)],
              lambda a, b: [loss_oracle.image_loss(a, b)], torch_loss),
        _same("L1 + SSIM, both gradients", text, (first, second), 2, lambda a, b: [image_loss(a, b)],
              lambda a, b: [loss_oracle.image_loss(a, b)], torch_loss),
        _same("TV of 3 channels", text, (first, second), 1, lambda a, b: [edge_aware_tv(a, b)],
              lambda a, b: [tv_oracle.edge_aware_tv(a, b)], lambda a, b: [tv_oracle.edge_aware_tv(a, b)]),
        _same("TV of depth", text, (depth, second), 1, lambda a, b: [edge_aware_tv(a, b)],
              lambda a, b: [tv_oracle.edge_aware_tv(a, b)], None),
        _same("depth to normals", text, (depth,), 1, lambda a: [depth_to_normals(a, view)], normals, normals),
        environment_map_case(view, text),
    ]  # fmt: skip


def environment_map_case(view: Camera, text: str) -> Case:
    """Return the case of the environment map: smooth maps of 64 texels a side, and a ball's normals in every pixel."""
    angles = torch.linspace(0, 9, 64)
    waves = 0.5 + 0.25 * (torch.sin(angles)[:, None, None] + torch.cos(angles[:, None] + torch.arange(3)))
    rows, columns = (torch.arange(side) + 0.5 - side / 2 for side in (view.height, view.width))
    across, along = (0.7 * x / x.abs().max() for x in torch.meshgrid(columns, rows, indexing="xy"))
    normals = torch.stack([across, along, -torch.sqrt(1 - across.square() - along.square())], dim=-1)
    K, pose = torch.from_numpy(view.K), torch.from_numpy(view.cam_from_world)

    def plain(maps: Tensor, normals: Tensor) -> list[Tensor]:
        return [environment_map_oracle.look_up_environment_map(maps, normals, K.to(maps), pose.to(maps))]

    def ours(maps: Tensor, normals: Tensor) -> list[Tensor]:
        return [look_up_environment_map(maps, normals, view)]

    return _same("environment map", text, (torch.stack([waves, waves.flip(0)]), normals), 2, ours, plain, plain)


def torch_loss(a: Tensor, b: Tensor) -> list[Tensor]:
    """Compute the oracle's loss in float32, with five convolutions."""
    window = loss_oracle.window().float()

    def blur(x: Tensor) -> Tensor:
        return torch.nn.functional.conv2d(x.permute(2, 0, 1)[None], window, padding=5, groups=3)

    mean_a, mean_b, aa, bb, ab = (blur(x) for x in (a, b, a * a, b * b, a * b))
    spread = aa - mean_a**2 + bb - mean_b**2
    ssim = (2 * mean_a * mean_b + 1e-4) * (2 * (ab - mean_a * mean_b) + 9e-4)
    ssim = ssim / ((mean_a**2 + mean_b**2 + 1e-4) * (spread + 9e-4))
    return [0.8 * (a - b).abs().mean() + 0.2 * (1 - ssim.mean())]


def splat_cases(count: int) -> list[Case]:
    """Return the cases of harmonics and Adam."""
    coeffs, means = torch.randn(count, 16, 3), torch.randn(count, 3)
    center = torch.tensor([0.0, 0.0, -3.0])
    values, slopes, text = torch.randn(count, 59), torch.randn(count, 59), f"{count} splats"

    def colors(coeffs: Tensor, means: Tensor, center: Tensor) -> list[Tensor]:
        return [harmonics_oracle.harmonics_to_rgb(coeffs, means, center, 3)]

    def exact(values: Tensor, slopes: Tensor) -> list[Tensor]:
        return [adam_oracle.steps(values, [slopes] * ADAM_STEPS, ADAM_RATE)]

    def ours(coeffs: Tensor, means: Tensor, center: Tensor) -> list[Tensor]:
        return [harmonics_to_rgb(coeffs, means, center, 3)]

    return [
        _same("harmonics, degree 3", text, (coeffs, means, center), 2, ours, colors, colors),
        _same(f"Adam, {ADAM_STEPS} steps of 59 a splat", text, (values, slopes), 0, adam_steps, exact, exact),
    ]  # fmt: skip


def adam_steps(values: Tensor, slopes: Tensor) -> list[Tensor]:
    """Return the values after equal steps of Adam."""
    leaf = values.clone().requires_grad_()
    optimizer = FusedAdam({"values": leaf}, {"values": ADAM_RATE})
    leaf.grad = slopes
    for _ in range(ADAM_STEPS):
        optimizer.step()
    return [leaf.detach()]


def _same(
    name: str, size: str, inputs: tuple[Tensor, ...], leaves: int, ours: Compute, oracle: Compute, plain: Compute | None
) -> Case:
    """Return a case that is compared on what it is timed on."""
    problem = Problem(inputs, ours, leaves)
    return Case(name, size, problem, problem, oracle, "oracle, on the same", [], plain)


def errors(case: Case, compute: Compute, device: str) -> Errors:
    """Return the errors of the outputs, and of the gradients that seeded gradients of the outputs bring."""
    outputs, gradients = _differentiated(case.compared, compute, device, torch.float32)
    true_outputs, true_gradients = _differentiated(case.compared, case.oracle, "cpu", torch.float64)
    if case.reference:
        outputs = [t.detach().cpu() for t in case.timed.compute(*case.timed.on(device, torch.float32))]
        true_outputs = case.reference
    misses = torch.cat([(a.double() - b).abs().flatten() for a, b in zip(outputs, true_outputs, strict=True)])
    worst, mean = [], []
    for ours, true in zip(gradients, true_gradients, strict=True):
        miss = (ours.double() - true).abs()
        worst.append(float(miss.max() / true.abs().max()))
        mean.append(float(miss.mean() / true.abs().mean()))
    return Errors(float(misses.max()), float(misses.mean()), max(worst, default=None), max(mean, default=None))


def _differentiated(
    problem: Problem, compute: Compute, device: str, dtype: torch.dtype
) -> tuple[list[Tensor], list[Tensor]]:
    """Return outputs and gradients, both on the processor."""
    inputs = problem.on(device, dtype)
    outputs = compute(*inputs)
    gradients: tuple[Tensor, ...] = ()
    if problem.leaves:
        gradients = torch.autograd.grad(outputs, inputs[: problem.leaves], [_seed(t) for t in outputs])
    return [t.detach().cpu() for t in outputs], [t.cpu() for t in gradients]


def _seed(output: Tensor) -> Tensor:
    """Return the same gradient of an output in every precision and on every device."""
    generator = torch.Generator().manual_seed(output.numel())
    return (
        torch.rand(output.shape, generator=generator, dtype=torch.float64).to(output)
        if output.ndim
        else (torch.ones_like(output))
    )


def times(problem: Problem, variants: list[str], computes: dict[str, Compute], runs: int) -> dict[str, list[Times]]:
    """Time the variants in turns, after two runs uncounted."""
    measured: dict[str, list[Times]] = {variant: [] for variant in variants}
    seeds: dict[str, list[Tensor]] = {}
    for run in range(runs + 2):
        for variant in variants:
            device = use(variant)
            inputs = problem.on(device, torch.float32)
            begin, begin_cpu = _now(device), time.process_time()
            outputs = computes[variant](*inputs)
            middle = _now(device)
            if problem.leaves:
                if variant not in seeds:
                    seeds[variant] = [_seed(t) for t in outputs]
                torch.autograd.grad(outputs, inputs[: problem.leaves], seeds[variant])
            end, cpu = _now(device), time.process_time() - begin_cpu
            if run >= 2:
                backward = (end - middle) * 1e3 if problem.leaves else None
                measured[variant].append(Times((middle - begin) * 1e3, backward, cpu * 1e3))
    return measured


def use(variant: str) -> str:
    """Choose a variant, and return the device that it computes on."""
    if variant == "cuda":
        return "cuda"
    if variant != "torch":
        runtime.set_isa(variant)
    return "cpu"


def _now(device: str) -> float:
    if device == "cuda":
        torch.cuda.synchronize()
    return time.perf_counter()


def rows_of(case: Case, variants: list[str], runs: int, note: str) -> list[KernelRow]:
    """Measure a case, and return a row for each variant."""
    computes = dict.fromkeys(variants, case.timed.compute)
    if case.plain is not None:
        computes["torch"] = case.plain
    measured = times(case.timed, list(computes), computes, runs)
    return [_row(case, variant, compute, measured[variant], note) for variant, compute in computes.items()]


def _row(case: Case, variant: str, compute: Compute, measured: list[Times], note: str) -> KernelRow:
    device = use(variant)
    found = errors(case, case.compared.compute if variant != "torch" else compute, device)
    backward = [run.backward for run in measured if run.backward is not None]
    return KernelRow(
        kernel=case.name,
        variant=variant,
        size=case.size,
        forward=statistics.median(run.forward for run in measured),
        backward=statistics.median(backward) if backward else None,
        least=min(run.forward + (run.backward or 0) for run in measured),
        cpu=statistics.median(run.cpu for run in measured),
        **found._asdict(),
        witness=case.witness,
        commit=program_commit(),
        machine=torch.cuda.get_device_name() if device == "cuda" else f"{processor_name()}, {_image.threads()} threads",
        note=note,
    )


def keep(file: Path, rows: list[KernelRow]) -> None:
    """Merge the rows into a table."""
    new = {(row.kernel, row.variant, row.size): row for row in rows}
    old = {(row.kernel, row.variant, row.size): row for row in read_kernels(file)}
    write_kernels(file, list((old | new).values()))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="the folder of the raster scenes")
    parser.add_argument("--scene", default="s20k_256")
    parser.add_argument("--size", type=int, default=256, help="the side of the images, in pixels")
    parser.add_argument("--splats", type=int, default=20000)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--threads", type=int, default=0, help="0: all processors")
    parser.add_argument("--note", default="", help="a note about the machine")
    parser.add_argument("--keep", type=Path, help="a results folder")
    args = parser.parse_args()
    torch.manual_seed(0)
    torch.set_num_threads(1)  # the kernels have threads of their own, and torch's would wait for them busily
    runtime.set_threads(args.threads)
    variants = [*(["cuda"] if torch.cuda.is_available() else []), *runtime.isas()]
    cases = raster_cases(args.folder / f"{args.scene}.npz") + image_cases(args.size) + splat_cases(args.splats)
    rows = [row for case in cases for row in rows_of(case, variants, args.runs, args.note)]
    print(kernel_table(rows))
    if args.keep is not None:
        keep(args.keep / KERNELS, rows)


if __name__ == "__main__":
    main()
