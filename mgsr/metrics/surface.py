"""Surface metrics: how close a mesh comes to the true surface, by sampled points."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from mgsr.errors import MeshError
from mgsr.geometry.mesh import Mesh
from mgsr.metrics.truth import DENSE, POINTS, Samples, TrueSurface, sample_surface

CLIP = 0.1  # radii; what is farther off counts as this far
F_LIMITS = {"f_005": 0.005, "f_010": 0.01, "f_020": 0.02}  # radii
MIN_VIEWS = 2


def surface_metrics(mesh: Mesh, truth: TrueSurface) -> dict[str, float]:
    """Measure distances and normals of a mesh, in the truth's frame, against the truth; return them by name.

    Distances are in the truth's bounding radius. accuracy: mean distance of area-uniform points of the mesh to the
    truth, without those whose nearest labelled truth point fewer than two training views see. completeness: mean
    distance of the truth points that two views or more see to the mesh. chamfer: the mean of both. f_005, f_010, f_020:
    F-scores at 0.5, 1 and 2%. normal_consistency: mean |n . n'| over nearest points, both ways;
    normal_consistency_signed: without the absolute value. What rests on no point at all, such as completeness where no
    two views see the same of the truth, is NaN.

    Raises MeshError for a mesh without faces.
    """
    if len(mesh.faces) == 0:
        raise MeshError("surface metrics: expected a mesh with faces, got none; extract a surface first")
    sparse, dense = (sample_surface(mesh, count, seed) for seed, count in enumerate((POINTS, DENSE)))
    seen = truth.view_counts >= MIN_VIEWS
    seen_truth = Samples(truth.labelled.points[seen], truth.labelled.normals[seen])
    nearest = cKDTree(truth.labelled.points).query(sparse.points, workers=-1)[1]
    kept, labels = Samples(sparse.points[seen[nearest]], sparse.normals[seen[nearest]]), nearest[seen[nearest]]
    # Unbalanced trees give the same neighbours and are built in half the time, which is most of it.
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


def _distances(to_truth: np.ndarray, to_mesh: np.ndarray) -> dict[str, float]:
    # A mesh that lies wholly where nobody looked has no accuracy of its own: it counts as far off.
    accuracy = float(to_truth.clip(max=CLIP).mean()) if len(to_truth) else CLIP
    completeness = _mean(to_mesh.clip(max=CLIP))
    values = {"chamfer": (accuracy + completeness) / 2, "accuracy": accuracy, "completeness": completeness}
    for name, limit in F_LIMITS.items():
        precise, complete = float((to_truth < limit).mean()) if len(to_truth) else 0.0, _mean(to_mesh < limit)
        values[name] = 2 * precise * complete / max(precise + complete, 1e-9)
    return values


def _mean(values: np.ndarray) -> float:
    return float(values.mean()) if len(values) else float("nan")
