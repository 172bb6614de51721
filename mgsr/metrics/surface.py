"""Metrics of a mesh against the true surface: by sampled points, and by rays through the test views' pixels."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from mgsr.data.camera import Camera
from mgsr.errors import MeshError
from mgsr.geometry.mesh import Mesh
from mgsr.geometry.raycast import RayHits
from mgsr.metrics.truth import DENSE, POINTS, Samples, TrueSurface, sample_surface

CLIP = 0.1  # radii; larger distances are clipped to this
F_LIMITS = {"f_005": 0.005, "f_010": 0.01, "f_020": 0.02}  # radii
MIN_VIEWS = 2


def surface_metrics(mesh: Mesh, truth: TrueSurface) -> dict[str, float]:
    """Measure distances and normals of a mesh, in the truth's frame, against the truth; return them by name.

    Distances are in the truth's bounding radius. accuracy: mean distance to the truth of points sampled uniformly by
    area on the mesh. A point counts if two training views or more see its nearest labelled truth point. completeness:
    mean distance of the truth points that two views or more see to the mesh. chamfer: the mean of both. f_005, f_010,
    f_020: F-scores at 0.5, 1 and 2%. normal_consistency: mean |n . n'| over nearest points, both ways;
    normal_consistency_signed: without the absolute value. A value without any points is NaN, such as completeness where
    no two views overlap on the truth.

    Raises MeshError for a mesh without faces.
    """
    if len(mesh.faces) == 0:
        raise MeshError("surface metrics: expected a mesh with faces, got no faces; extract a surface first")
    sparse, dense = (sample_surface(mesh, count, seed) for seed, count in enumerate((POINTS, DENSE)))
    seen = truth.view_counts >= MIN_VIEWS
    seen_truth = Samples(truth.labelled.points[seen], truth.labelled.normals[seen])
    nearest = cKDTree(truth.labelled.points).query(sparse.points, workers=-1)[1]
    kept, labels = Samples(sparse.points[seen[nearest]], sparse.normals[seen[nearest]]), nearest[seen[nearest]]
    # Unbalanced trees give the same neighbours, and halve the build time, which dominates.
    true_dense = sample_surface(truth.mesh, DENSE, seed=2)
    to_truth = cKDTree(true_dense.points, balanced_tree=False).query(kept.points, workers=-1)[0] / truth.radius
    to_mesh, index = cKDTree(dense.points, balanced_tree=False).query(seen_truth.points, workers=-1)
    cosines = [
        (kept.normals * truth.labelled.normals[labels]).sum(1),
        (dense.normals[index] * seen_truth.normals).sum(1),
    ]
    return _distances(to_truth, to_mesh / truth.radius) | {
        "normal_consistency": float(np.mean([_mean(np.abs(cosine)) for cosine in cosines])),
        "normal_consistency_signed": float(np.mean([_mean(cosine) for cosine in cosines])),
    }


def normal_metrics(mesh: Mesh, truth: TrueSurface, cameras: Sequence[Camera]) -> dict[str, float]:
    """Return the mean errors over the cameras (user's frame) of a mesh's normals, silhouettes and depths, by name.

    normal_error: degrees between face normals where both are hit; normal_error_median; mask_iou of the silhouettes;
    depth_error, in the truth's bounding radius. A view in which no pixel shows both is left out of all but mask_iou;
    all are NaN where every view is.
    """
    ours, true = mesh.caster, truth.mesh.caster
    views = [compare_hits(ours.cast(camera), true.cast(camera), truth.radius) for camera in cameras]
    names = ("normal_error", "normal_error_median", "mask_iou", "depth_error")
    return {name: _mean(np.array([view[name] for view in views if name in view])) for name in names}


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


def _distances(to_truth: np.ndarray, to_mesh: np.ndarray) -> dict[str, float]:
    """Return the scores of distances to the truth [P] and to the mesh [Q], in bounding radii, by name."""
    # A mesh wholly outside the observed region has no accuracy; it counts as CLIP.
    accuracy = float(to_truth.clip(max=CLIP).mean()) if len(to_truth) else CLIP
    completeness = _mean(to_mesh.clip(max=CLIP))
    values = {"chamfer": (accuracy + completeness) / 2, "accuracy": accuracy, "completeness": completeness}
    for name, limit in F_LIMITS.items():
        precise, complete = float((to_truth < limit).mean()) if len(to_truth) else 0.0, _mean(to_mesh < limit)
        values[name] = 2 * precise * complete / max(precise + complete, 1e-9)
    return values


def _mean(values: np.ndarray) -> float:
    """Return the mean of values [P], NaN without any."""
    return float(values.mean()) if len(values) else float("nan")
