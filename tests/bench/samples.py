"""Made-up rows of a matrix: two scenes, two methods, two presets, and some ablation rows."""

from __future__ import annotations

from typing import Any

from mgsr.bench.results import Row

MACHINE, VERSIONS = "a processor, 2 cores, avx2 kernels", "mgsr 0.1.0 torch 2.13.0"


def sample_row(scene: str, variant: str = "", method: str = "mgsr", preset: str = "standard", **changes: float) -> Row:
    """Build a done row of made-up figures with `changes`."""
    figures: dict[str, Any] = {
        "seconds": 300.0, "start_seconds": 20.0, "train_seconds": 220.0, "mesh_seconds": 50.0, "psnr": 34.0,
        "psnr_object": 28.0, "ssim": 0.97, "chamfer": 2.5, "f_score": 0.92, "normal_consistency": 98.0,
        "normal_error": 7.0, "model_mib": 13.0, "memory_mib": 1600.0, "others": 0.1,
    }  # fmt: skip
    return Row(
        scene, variant, method, preset, "cpu", 0, "done", surfels=20000, gaussians=0 if method == "2dgs" else 20000,
        faces=100000, scored_by="evaluate.py", commit="abc1234", machine=MACHINE, versions=VERSIONS,
        command="mgsr run", **(figures | changes),
    )  # fmt: skip


def sample_rows() -> list[Row]:
    """Build rows in the order in which tables keep them."""
    rows = []
    for scene in ("apple", "pear"):
        rows += [sample_row(scene, preset="draft", seconds=60.0, psnr=33.0), sample_row(scene)]
        rows += [sample_row(scene, method="2dgs", psnr=30.0, chamfer=2.4), sample_row(scene, "K", psnr=33.5)]
    return sorted(rows, key=lambda row: row.key)
