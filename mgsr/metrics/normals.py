"""Metrics of a mesh's normals and silhouettes against the truth in the test views, by ray casting."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mgsr.data.camera import Camera
from mgsr.geometry.mesh import Mesh
from mgsr.geometry.raycast import RayHits
from mgsr.metrics.truth import TrueSurface


def normal_metrics(mesh: Mesh, truth: TrueSurface, cameras: Sequence[Camera]) -> dict[str, float]:
    """Return the mean errors over the cameras (user's frame) of a mesh's normals, silhouettes and depths, by name.

    normal_error: degrees between face normals where both are hit; normal_error_median; mask_iou of the silhouettes;
    depth_error, in the truth's bounding radius. A view in which no pixel shows both is left out of all but mask_iou;
    all are NaN where every view is.
    """
    ours, true = mesh.caster, truth.mesh.caster
    views = [compare_hits(ours.cast(camera), true.cast(camera), truth.radius) for camera in cameras]
    names = ("normal_error", "normal_error_median", "mask_iou", "depth_error")
    return {name: _mean([view[name] for view in views if name in view]) for name in names}


def compare_hits(hits: RayHits, true: RayHits, radius: float) -> dict[str, float]:
    """Return one view's errors by name; only mask_iou where the two share no pixel."""
    both, either = hits.mask & true.mask, hits.mask | true.mask
    values = {"mask_iou": float(both.sum() / max(either.sum(), 1))}
    if both.any():
        cosines = (hits.normal[both] * true.normal[both]).sum(1, dtype=np.float64)
        errors = np.degrees(np.arccos(np.clip(cosines, -1, 1)))
        values["normal_error"], values["normal_error_median"] = float(errors.mean()), float(np.median(errors))
        values["depth_error"] = float(np.abs(hits.depth - true.depth)[both].mean()) / radius
    return values


def _mean(values: list[float]) -> float:
    return float(np.mean(values)) if values else float("nan")
