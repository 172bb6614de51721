"""A scene's true surface, and which of its points the training views see."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh

from mgsr.data.camera import Camera
from mgsr.errors import SceneError
from mgsr.geometry.mesh import Mesh

POINTS = 100_000
DENSE = 1_000_000

TRUTH = "mesh_gt.ply"  # in a scene's folder


@dataclass(frozen=True)
class Samples:
    """Points [P,3] on a surface, area-uniform, and the unit normals [P,3] of their faces."""

    points: np.ndarray
    normals: np.ndarray


@dataclass(frozen=True)
class TrueSurface:
    """The true surface in the user's frame.

    labelled: samples of the surface.
    view_counts [P]: the number of training views that see each sample.
    radius: the radius of the bounding sphere around the middle of the bounding box, the unit of all distances.
    """

    mesh: Mesh
    labelled: Samples
    view_counts: np.ndarray
    radius: float


def load_truth(folder: Path, train_cameras: Sequence[Camera]) -> TrueSurface | None:
    """Load the true surface beside a scene, ``mesh_gt.ply``; None where there is none.

    Its samples have the labels of ``points_gt.npz``, or else those found by ray casting from the training cameras
    (user's frame). Raises SceneError for a mesh without faces.
    """
    path = folder / TRUTH
    if not path.is_file():
        return None
    stored = trimesh.load_mesh(path, process=False)
    mesh = Mesh(np.asarray(stored.vertices, np.float64), np.asarray(stored.faces, np.int64))
    if len(mesh.faces) == 0:
        raise SceneError(
            f"{path}: expected a triangle mesh, found no faces; write the true surface, or remove the file"
        )
    middle = (mesh.vertices.min(0) + mesh.vertices.max(0)) / 2
    radius = float(np.linalg.norm(mesh.vertices - middle, axis=1).max())
    labelled, counts = _labels(folder / "points_gt.npz", mesh, train_cameras, radius)
    return TrueSurface(mesh, labelled, counts, radius)


def _labels(path: Path, mesh: Mesh, cameras: Sequence[Camera], radius: float) -> tuple[Samples, np.ndarray]:
    """Return samples of the surface and the number [P] of training views that see each.

    They come from the file at `path`, or else from ray casting. radius: of the truth, the unit of the tolerance.
    """
    if path.is_file():
        stored = np.load(path)
        points, normals = stored["points"].astype(np.float64), stored["normals"].astype(np.float64)
        return Samples(points, normals), stored["n_views"]
    labelled = sample_surface(mesh, POINTS, seed=3)
    counts = np.zeros(POINTS, np.int32)
    for camera in cameras:
        counts += mesh.caster.sees(camera, labelled.points, gap=1e-4 * radius)
    return labelled, counts


def sample_surface(mesh: Mesh, count: int, seed: int) -> Samples:
    """Sample `count` points on a mesh, area-uniform."""
    drawn = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    points, index = trimesh.sample.sample_surface(drawn, count, seed=seed)
    return Samples(np.asarray(points), np.asarray(drawn.face_normals)[index])
