"""Counts of the instructions that the rasterizers' kernels take on a scene, from their machine code, without a GPU.

    python -m benchmarks.count_instructions [--arch sm_90] [--gsplat FOLDER] [--scene FILE.npz] [--keep FILE]

Needs nvdisasm and cuobjdump (packages nvidia-cuda-nvdisasm and nvidia-cuda-cuobjdump), from the PATH or named by
options, and for gsplat's kernels nvcc and CUDA's headers. gsplat's source is the folder that holds gsplat/, by default
the package of version 1.5.3 from PyPI, unpacked for the while of the run; without it its rows are left out.

A kernel's loops come from the jumps of its machine code (sass.py). A turn of the innermost one, a step, is one splat at
a warp's pixels; unrolled steps are told apart by their exponentials, of which each has one. Parts that a branch may
skip count with the share of steps in which a pixel of the warp blends the splat. How often each loop turns is counted
on the scene, by default that of 100k splats of rasterizers.py on 800 x 800 pixels, by doing the walks with whole
arrays (walks.py). Instructions are no times: waiting for memory, for other units and for atomics is not in them.
"""

from __future__ import annotations

import argparse
import re
import shutil
import subprocess
import sys
import tempfile
import zipfile
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from benchmarks import walks
from benchmarks.rasterizers import Scene, make_scene
from benchmarks.sass import Loop, Resources, disassemble, loops_of, resources
from mgsr.data.camera import Camera
from mgsr.native.cuda.compiler import compile_family

GSPLAT = "gsplat==1.5.3"
SPLAT_NAMES = ("means", "quats", "scales", "opacities", "rgb")
# By compute capability: warps an SM holds, and KiB of its shared memory.
GPUS = {"75": (32, 64), "80": (64, 164), "86": (48, 100), "89": (48, 100), "90": (64, 228), "100": (64, 228)}
GPUS["120"] = (48, 100)
REGISTERS, REGISTER_GRAIN, RESERVED = 65536, 8, 1  # a SM's; a thread's are rounded up to this; KiB a block more
BLOCK_WARPS = {"project": 4, "gradients": 4, "blend": 8, "pixels": 8, "backward": 2, "rasterize": 8}


@dataclass(frozen=True)
class Kernel:
    """A kernel's loops, and the registers and memory that it takes."""

    name: str
    code: Loop
    taken: Resources

    @property
    def nest(self) -> list[Loop]:
        """Return the loops around a step, from the kernel itself to the step's."""
        nest = [self.code]
        while inner := [loop for loop in nest[-1].inner if any(deep.exponentials for deep in loop.all_inner())]:
            nest.append(max(inner, key=lambda loop: max(deep.exponentials for deep in loop.all_inner())))
        return nest

    def step(self, useful: float) -> float:
        """Return the instructions of a step, of which the share `useful` blends its splat."""
        innermost = self.nest[-1]
        return innermost.at(useful) / innermost.exponentials

    def warps(self, arch: str) -> int:
        """Return how many of the kernel's warps an SM holds."""
        most, shared = GPUS[arch.removeprefix("sm_")]
        block = next(warps for part, warps in BLOCK_WARPS.items() if part in self.name)
        registers = -(-self.taken.registers // REGISTER_GRAIN) * REGISTER_GRAIN
        kib = self.taken.shared / 1024 + RESERVED
        blocks = min(most // block, REGISTERS // (registers * 32 * block), int(shared / kib))
        return block * blocks


@dataclass(frozen=True)
class Row:
    """Warp instructions of forward and of backward, in millions."""

    name: str
    forward: float
    backward: float

    @property
    def both(self) -> float:
        return self.forward + self.backward


def read_kernels(cubin: Path, args: argparse.Namespace) -> dict[str, Kernel]:
    """Return the kernels of a cubin, by name."""
    taken = resources(cubin, args.cuobjdump)
    return {name: Kernel(name, loops_of(text), taken[name]) for name, text in disassemble(cubin, args.nvdisasm).items()}


def our_kernels(folder: Path, args: argparse.Namespace) -> dict[str, Kernel]:
    found: dict[str, Kernel] = {}
    for family in ("gaussians", "surfels"):
        cubin = folder / f"{family}.cubin"
        cubin.write_bytes(compile_family(family, args.arch))
        found |= read_kernels(cubin, args)
    return found


def gsplat_kernels(folder: Path, args: argparse.Namespace) -> dict[str, Kernel]:
    """Return gsplat's kernels of three channels, as `forward` and `backward`; empty where they can't be compiled."""
    try:
        source = args.gsplat or fetch_gsplat(folder)
        return {way: compile_gsplat(source / "gsplat" / "cuda", way, folder, args) for way in ("forward", "backward")}
    except (OSError, subprocess.CalledProcessError) as error:
        print(f"without gsplat's kernels: {error}", file=sys.stderr)
        return {}


def fetch_gsplat(folder: Path) -> Path:
    """Download gsplat's package from PyPI, and unpack it."""
    pip = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--dest", str(folder), GSPLAT]
    subprocess.run(pip, check=True)
    with zipfile.ZipFile(next(folder.glob("gsplat*.whl"))) as wheel:
        wheel.extractall(folder / "gsplat")
    return folder / "gsplat"


def compile_gsplat(source: Path, way: str, folder: Path, args: argparse.Namespace) -> Kernel:
    """Compile one rasterizing kernel, with the options that gsplat is built with.

    Its launcher and torch are left out, and what a rendering does not ask for: background, masks and absolute
    gradients.
    """
    short = {"forward": "Fwd", "backward": "Bwd"}[way]
    text = (source / "csrc" / f"RasterizeToPixels3DGS{short}.cu").read_text()
    text = text[: text.index("template <uint32_t CDIM>\nvoid launch")]
    text = re.sub(r"(backgrounds|masks|v_means2d_abs) != nullptr", "false", text)
    text = re.sub(r'#include <(ATen|c10)/.*|#include "Rasterization.h"', "", text)
    signature = re.search(r"__global__ void (\w+)\((.*?)\) \{", text, re.DOTALL)
    assert signature is not None, f"{source}: no kernel in it"
    arguments = re.sub(r"//.*", "", signature[2]).replace("scalar_t", "float")
    text += f"template __global__ void {signature[1]}<3, float>({arguments});\n}}\n"
    cu, cubin = folder / f"{way}.cu", folder / f"{way}.cubin"
    cu.write_text("#define gpuAtomicAdd atomicAdd\n" + text)
    headers = [f"-I{source / 'include'}", f"-I{source / 'csrc' / 'third_party' / 'glm'}"]
    options = ["-cubin", f"-arch={args.arch}", "-O3", "-use_fast_math", "-std=c++17", "-w"]
    subprocess.run([args.nvcc, *options, *headers, str(cu), "-o", str(cubin)], check=True)
    (kernel,) = read_kernels(cubin, args).values()
    dynamic = 256 * 4 * (7 if way == "forward" else 10)  # bytes that its launcher asks for
    return Kernel(kernel.name, kernel.code, Resources(kernel.taken.registers, kernel.taken.stack, dynamic))


def our_row(kernels: dict[str, Kernel], kind: str, counts: Counter[str]) -> Row:
    """Return the instructions of our kernels: of blending, and of preparing pixels and walking back."""
    useful = counts["useful"] / counts["steps"]
    blend, back, pixels = (kernels[f"gaussians_{part}_{kind}"] for part in ("blend", "backward", "pixels"))
    kernel, batch, bucket, _ = blend.nest
    forward = counts["warps"] * kernel.at(1) + counts["batches"] * batch.at(1) + counts["buckets"] * bucket.at(1)
    kernel, patch, chunk, _ = back.nest
    search = sum(loop.at(1) for loop in kernel.inner if loop is not patch) * np.log2(counts["warps"] / 8)
    backward = counts["back_buckets"] * (kernel.at(1) + search + walks.PATCHES * patch.always)
    backward += counts["back_patches"] * patch.sometimes + counts["back_chunks"] * chunk.at(1)
    backward += counts["warps"] * pixels.code.at(1)
    steps = (counts["steps"] * kernel.step(useful) / 1e6 for kernel in (blend, back))
    return Row(kind, forward / 1e6 + next(steps), backward / 1e6 + next(steps))


def gsplat_row(kernels: dict[str, Kernel], name: str, passes: list[Counter[str]]) -> Row:
    """Return the instructions of gsplat's kernels in one pass, or in several added up."""
    sums = {}
    for way, prefix in (("forward", ""), ("backward", "back_")):
        kernel, batch, _ = kernels[way].nest
        sums[way] = sum(
            counts["warps"] * kernel.at(1)
            + counts[prefix + "batches"] * batch.at(1)
            + counts[prefix + "steps"] * kernels[way].step(counts[prefix + "useful"] / counts[prefix + "steps"])
            for counts in passes
        )
    return Row(name, sums["forward"] / 1e6, sums["backward"] / 1e6)


def read_scene(path: Path | None) -> Scene:
    """Read the scene of a file, with some reflected light; by default that of 100k splats."""
    scene = make_scene("100k/800", torch.device("cpu"))
    if path is None:
        return scene
    stored = np.load(path)
    leaves = tuple(torch.tensor(stored[name]) for name in SPLAT_NAMES)
    size = int(stored["width"]), int(stored["height"])
    camera = Camera(stored["K"].astype(float), stored["viewmat"].astype(float), *size)
    count = len(leaves[0])
    lit = type(scene.reflected)(*(t.repeat(-(-count // len(t)), *[1] * (t.dim() - 1))[:count] for t in scene.reflected))
    return Scene(leaves, lit, camera, scene.background)


def totals(kernels: dict[str, Kernel], gsplat: dict[str, Kernel], scene: Scene) -> list[str]:
    """Return the scene's instructions as lines of Markdown."""
    lines = [
        "| pass | forward | backward | both | of gsplat's | steps |",
        "|---|---|---|---|---|---|",
    ]
    for kind in ("single", "dual"):
        view = walks.project(scene, kind == "dual")
        counts = walks.count_ours(view, kind == "dual")
        rows = [our_row(kernels, kind, counts)]
        if gsplat:
            passes = [walks.count_gsplat(view, opacity) for opacity in range(1 if kind == "single" else 2)]
            rows.append(gsplat_row(gsplat, {"single": "gsplat", "dual": "gsplat twice"}[kind], passes))
        for row, steps in zip(rows, (counts["steps"], sum(c["steps"] for c in passes) if gsplat else 0), strict=False):
            ratio = f"{row.both / rows[-1].both:.2f}" if gsplat and row is not rows[-1] else ""
            numbers = f"{row.forward:.0f} | {row.backward:.0f} | {row.both:.0f} | {ratio} | {steps / 1e6:.2f}"
            lines.append(f"| {row.name} | {numbers} |")
    return lines


def table(kernels: dict[str, Kernel], arch: str) -> list[str]:
    """Return what each kernel takes, as lines of Markdown."""
    lines = [
        "| kernel | a step | of which may be skipped | around it, outwards | registers | shared bytes | stack "
        "| warps/SM | float64 always | float64 else |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for kernel in kernels.values():
        nest, taken = kernel.nest, kernel.taken
        step = skipped = "-"
        if len(nest) > 1 and nest[-1].exponentials:
            step, skipped = f"{kernel.step(1):.0f}", f"{kernel.step(1) - kernel.step(0):.0f}"
        around = ", ".join(f"{loop.at(1):.0f}" for loop in (nest[-2::-1] if step != "-" else nest[:1]))
        always = kernel.code.always_doubles
        doubles = sum(loop.always_doubles + loop.sometimes_doubles for loop in kernel.code.all_inner())
        numbers = f"{step} | {skipped} | {around} | {taken.registers} | {taken.shared} | {taken.stack}"
        name = re.sub(r".*rasterize_to_pixels_3dgs_(fwd|bwd)_kernel.*", r"gsplat \1 (rasterize)", kernel.name)
        lines.append(f"| {name} | {numbers} | {kernel.warps(arch)} | {always} | {doubles - always} |")
    return lines


def report(args: argparse.Namespace) -> str:
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        kernels, gsplat = our_kernels(folder, args), gsplat_kernels(folder, args)
    scene = read_scene(args.scene)
    count, size = len(scene.leaves[0]), f"{scene.camera.width} x {scene.camera.height}"
    return "\n".join(
        [
            "# Instructions of the rasterizers' CUDA kernels",
            "",
            f"`benchmarks/count_instructions.py` made this page for {args.arch} and describes what it counts, and "
            "how. Figures are millions of warp instructions and of steps of the forward pass, for one view of "
            f"{count} splats on {size} pixels:",
            "",
            *totals(kernels, gsplat, scene),
            "",
            "The next table has instructions of a warp, by kernel:",
            "",
            *table(kernels | gsplat, args.arch),
            "" if gsplat else f"\n{GSPLAT} could not be compiled here, so it has no rows and no ratios",
        ]
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--arch", default="sm_90", choices=[f"sm_{gpu}" for gpu in GPUS])
    parser.add_argument("--scene", type=Path, help="a folder of splats and a view, as in shared/data/raster")
    parser.add_argument("--gsplat", type=Path, help="the folder that holds gsplat's source, gsplat/")
    parser.add_argument("--keep", type=Path, help="the Markdown file to write")
    for tool in ("nvdisasm", "cuobjdump", "nvcc"):
        parser.add_argument(f"--{tool}", default=shutil.which(tool) or tool)
    args = parser.parse_args()
    text = report(args).rstrip() + "\n"
    print(text)
    if args.keep is not None:
        args.keep.write_text(text)


if __name__ == "__main__":
    main()
