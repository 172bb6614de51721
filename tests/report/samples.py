"""A made-up run and pictures of it: a report's parts without training."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from mgsr.report.data import (
    CurvePoint,
    FrameFacts,
    InputFacts,
    MachineFacts,
    MeshFacts,
    ReportData,
    SplitFacts,
    StageRun,
    StartFacts,
)
from mgsr.report.pictures import ReportPictures, SurfacePictures, TestViewPictures
from mgsr.report.shading import PaintedMesh


def sample_report(scene: str = "bunny_flash", command: str = "mgsr-worker run bunny_flash -o out") -> ReportData:
    """Build the report of a run of all three stages with ground truth."""
    stages = {"warmup_surfels": (2000, 70.0), "warmup_gaussians": (2000, 60.0), "mutual": (3000, 150.0)}
    return ReportData(
        scene=scene, preset="standard", method="mgsr", device="cpu", seed=0,
        versions={"mgsr": "0.1.0", "python": "3.11.7", "torch": "2.13.0"},
        seconds={"total": 295.2, "load": 0.8, "train": 280.0, **{name: s for name, (_, s) in stages.items()}},
        iterations={
            name: StageRun(count, "converged" if name.startswith("w") else "iterations")
            for name, (count, _) in stages.items()
        },
        gaussians={"surfels": 14210, "gaussians": 21877},
        psnr_test=36.82, ssim_test=0.9871, curve=_curve(),
        mesh=MeshFacts(61204, 122011, 1, 393, 2),
        gt={"chamfer": 0.00213, "accuracy": 0.0019, "completeness": 0.0024, "f_005": 0.948,
            "normal_consistency": 0.978, "normal_error": 6.4},
        peak_memory_mib=1342.0, command=command,
        input=InputFacts(
            "bunny_flash", "nerfstudio", [f"r_{i}" for i in range(48)], ["r_0"], [256, 256], True, 0,
            FrameFacts(1.0, [0.0, 0.0, 0.0]), starting_points=StartFacts("hull", 9000),
        ),
        settings={"mesh": {"extractor": "poisson", "close_holes": False}},
        machine=MachineFacts("Linux", "x86_64", 2, "avx512"), psnr_fg_test=29.9, split=SplitFacts(33.1, 29.1, 4.0),
    )  # fmt: skip


def bare_report() -> ReportData:
    """Return the sample without all that a report may lack."""
    return replace(sample_report(), input=None, settings=None, machine=None, psnr_fg_test=None, split=None)


def sample_pictures(name: str = "r_0", views: int = 2, size: int = 24) -> ReportPictures:
    """Draw seeded noise for every picture that a report may hold."""
    random = np.random.default_rng(1)
    image = random.integers(0, 256, (size, size, 4), dtype=np.uint8)
    pictures = (image, image, image, image[..., :3], image, image, image)
    shown = [TestViewPictures(name, *pictures, 31.0) for _ in range(views)]
    return ReportPictures(shown, (), SurfacePictures())


def ball(radius: float = 1.0, rings: int = 24) -> PaintedMesh:
    """Build a sphere round the origin from a grid of angles, with exact normals."""
    polar, around = np.meshgrid(np.linspace(0, np.pi, rings), np.linspace(0, 2 * np.pi, 2 * rings), indexing="ij")
    ring = np.sin(polar)
    normals = np.stack([ring * np.cos(around), ring * np.sin(around), np.cos(polar)], -1).reshape(-1, 3)
    index = np.arange(rings * 2 * rings).reshape(rings, 2 * rings)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    return PaintedMesh(radius * normals, faces).with_normals(normals)


def _curve() -> list[CurvePoint]:
    rows = []
    for step in range(57):
        seconds = 5.0 * step
        stage = "warmup_surfels" if seconds <= 70 else "warmup_gaussians" if seconds <= 130 else "mutual"
        flat = 20 + 13 * (1 - math.exp(-min(seconds, 70) / 25)) + (max(0, seconds - 130) / 150) * 1.2
        full = None if seconds <= 70 else 21 + 15.5 * (1 - math.exp(-(seconds - 70) / 30))
        surfels = int(6000 + 8210 * min(1, seconds / 180))
        gaussians = 0 if full is None else int(6000 + 90 * (seconds - 70))
        psnr = flat if full is None else full
        rows.append(CurvePoint(seconds, stage, 40 * step, psnr, flat, full, surfels, gaussians))
    return rows
